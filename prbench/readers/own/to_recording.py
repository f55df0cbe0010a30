"""Converts the content of one plain recording to a :class:`Recording`; the only place where units and axes change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench import recording as streams
from prbench.errors import InputFileError, did_you_mean
from prbench.files.arrays import first_repeated
from prbench.files.bounded import require
from prbench.geometry.timelines import covered, require_overlap, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.extents import SEVERAL_SENSORS
from prbench.readers.files import read_entries
from prbench.readers.found import RecordingFiles
from prbench.readers.own import format as own
from prbench.readers.own.files import Readings, Table
from prbench.representation.converters import check_sides

_Poses = tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"], Bool[np.ndarray, " n"]]
_Box = tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
_TRUE = ("true", "yes", "1")
_NO_EVENTS = "no events: write an events table, or object_poses and the wrists (or a body) in which they are found"
_EVENT = "an event: an action, an object, a time or frame, and numbers in the other columns"


def recording_from_tables(readings: Readings, manifest: Manifest, found: RecordingFiles) -> streams.Recording:
    """Return the streams of a plain recording, whichever it has.

    Args:
        readings: Content of its files.
        manifest: Source of bodies where the recording states none, head tilt and thresholds.
        found: Its name, for messages and the recording.

    Raises:
        InputFileError: if tables contradict one another.
        StreamsDoNotOverlap: if head, gaze and body share no instant.
    """
    about = readings.about
    tables = readings.tables
    head = streams.NO_POSES
    gaze = streams.NO_GAZE
    body = None
    hands: tuple[streams.HandStream, ...] = ()
    messages = []
    if "head" in tables:
        times, position, rotation, valid = _poses(about, tables["head"])
        facing = Rotation.from_quat(rotation, scalar_first=True) * Rotation.from_matrix(about.head_from_cpf)
        head = streams.PoseStream(times, position, facing.as_quat(scalar_first=True), valid)
    if "gaze" in tables:
        gaze = _gaze(about, tables["gaze"], head, manifest.thresholds["longest_head_gap"])
        if lost := int((tables["gaze"].measured(own.GAZE) & ~gaze.valid).sum()):
            messages.append(f"gaze: {lost} of {len(gaze.times)} samples have no origin, or no pose of the head nearby")
    if "body" in tables:
        body = _body(about, tables["body"])
        hands = body.wrists()
        if lost := int((~body.valid).sum()):
            messages.append(f"body: {lost} of {len(body.times)} frames lack joints or change their bones: left out")
    if "wrists" in tables:
        wrists = tables["wrists"]
        hands = tuple(_wrist(about, wrists, side) for side in streams.SIDES)
    objects = _objects(about, tables)
    moving = {f"object {track.object_id}": track.times for track in objects if len(track.times) > 1}
    if not readings.events and not (moving and hands):
        messages.append(_NO_EVENTS)
    # Objects and hands may be out of sight for long; the other streams last as long as the recording.
    lasting = stream_ranges({"head": head.times, "gaze": gaze.times, "body": None if body is None else body.times})
    if lasting:
        require_overlap(lasting, recording=found.recording_id)
    ranges = lasting | stream_ranges({**moving, **{f"{hand.side} wrist": hand.times for hand in hands}})
    starts, ends = zip(*ranges.values()) if ranges else ((-np.inf,), (np.inf,))
    world_from_source = np.eye(4)
    world_from_source[:3, :3] = about.turn * about.metres
    known = streams.Recording(
        dataset=found.dataset,
        recording_id=found.recording_id,
        participant_id=about.participant,
        pose_source="none" if body is None else about.body.source or manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        span=(min(starts), max(ends)) if ranges else (0.0, 0.0),
        gaze=gaze,
        camera=streams.NO_POSES,
        head=head,
        body=body,
        hands=hands,
        objects=objects,
        world_from_source=world_from_source,
        messages=tuple(messages),
    )
    events, unreadable = _events(readings, known, (min(starts), max(ends)), manifest.thresholds)
    times = [event.event_time for event in events]
    span = known.span if ranges or not times else (min(times), max(times))
    return replace(known, span=span, annotated_events=tuple(events), unreadable=tuple(unreadable))


def _poses(about: own.About, table: Table, rows: Int[np.ndarray, " n"] | slice = slice(None)) -> _Poses:
    """Return times, positions, rotations and validity of some rows of a table of poses."""
    valid = table.measured(own.POINT)[rows]
    rotation = np.tile([1.0, 0.0, 0.0, 0.0], (len(valid), 1))
    if own.QUATERNION[0] in table.columns:
        valid &= table.measured(own.QUATERNION)[rows]
        rotation[valid] = table.vectors(own.QUATERNION)[rows][valid]
    matrices = about.turn @ Rotation.from_quat(rotation, scalar_first=True).as_matrix() @ about.mirror
    position = streams.hold_neighbours(about.points(table.vectors(own.POINT)[rows]), valid)
    turned = Rotation.from_matrix(matrices).as_quat(scalar_first=True)
    return table.columns["time"][rows] * about.seconds, position, turned, valid


def _gaze(about: own.About, table: Table, head: streams.PoseStream, longest: float) -> streams.GazeStream:
    """Return the gaze rays; directions in the axes of the head need its pose, and so do rays without an origin."""
    times = table.columns["time"] * about.seconds
    in_head = about.gaze.frame == "head"
    has_origin = own.ORIGIN[0] in table.columns
    needs = "a head table beside it, because gaze.frame is 'head'" if in_head else "ox, oy, oz, or a head table"
    require(table.path, (len(head.times) or (has_origin and not in_head), "", needs, "none", "Add the head's poses."))
    valid = table.measured(own.GAZE)
    direction = np.where(valid[:, None], table.vectors(own.GAZE), [0.0, 0.0, 1.0])
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    offset = np.zeros((len(times), 3))
    if has_origin:
        valid &= table.measured(own.ORIGIN)
        offset = np.nan_to_num(table.vectors(own.ORIGIN))
    if in_head or not has_origin:
        position, rotation = head.pose_at(times)
        valid &= covered(head.times, head.valid, times, max_gap=longest)
        facing = Rotation.from_quat(rotation, scalar_first=True) * Rotation.from_matrix(about.head_from_cpf.T)
        origin = position + facing.apply(offset @ about.mirror) * about.metres
    else:
        origin = about.points(offset)
    direction = facing.apply(direction @ about.mirror) if in_head else direction @ about.turn.T
    return streams.GazeStream(times, streams.hold_neighbours(origin, valid), direction, valid)


def _body(about: own.About, table: Table) -> streams.BodyStream:
    times = table.columns["time"] * about.seconds
    native = about.points(table.vectors(own.body_columns(about)).reshape(len(times), -1, 3))
    joints = own.SKELETONS[about.body.skeleton].to_22(native, source=table.path)
    valid = streams.plausible_body_frames(times, joints)
    try:
        check_sides(joints[valid][:: max(1, int(valid.sum()) // 1000)], source=table.path)
    except InputFileError as error:
        remedy = (
            f"Of a left-handed world (Unity, Unreal) {own.ABOUT_FILE} says axes.handed = 'left'. Else left and right"
        )
        about_it = {"expected": error.expected, "found": error.found, "remedy": f"{remedy} joints are exchanged."}
        raise InputFileError(table.path, error.where, **about_it) from error
    return streams.BodyStream(times, streams.hold_neighbours(joints, valid), valid)


def _wrist(about: own.About, table: Table, side: streams.Side) -> streams.HandStream:
    rows = np.array([text.lower() == side for text in table.columns["side"]], dtype=bool)
    valid = table.measured(own.POINT)[rows]
    points = streams.hold_neighbours(about.points(table.vectors(own.POINT)[rows]), valid)
    return streams.HandStream(side, "wrist", table.columns["time"][rows] * about.seconds, points[:, None], valid)


def _objects(about: own.About, tables: Mapping[str, Table]) -> tuple[streams.ObjectTrack, ...]:
    """Return a track of each object of which poses are known."""
    poses = tables.get("object_poses")
    if poses is None:
        return ()
    ids = poses.columns["object_id"].astype(str)
    listed = tables.get("objects")
    if listed is None:
        rows_of = {name: {} for name in np.unique(ids).tolist()}
    else:
        names = listed.columns["object_id"].astype(str).tolist()
        twice = first_repeated(names)
        require(listed.path, (twice is None, "column 'object_id'", "each object once", f"'{twice}' twice", ""))
        strange = ~np.isin(ids, names)
        remedy = did_you_mean(ids[strange.argmax()], names).strip() if strange.any() else ""
        poses.refuse(strange, "object_id", "an object of the objects table", ids.__getitem__, remedy)
        rows_of = {name: {key: each[row] for key, each in listed.columns.items()} for row, name in enumerate(names)}
    order = np.argsort(ids, kind="stable")
    tracks = []
    for name, row in rows_of.items():
        rows = order[np.searchsorted(ids[order], name) : np.searchsorted(ids[order], name, side="right")]
        if not len(rows):
            continue  # only its name is known
        low, high = _corners(np.nan_to_num([row.get(column, 0.0) for column in own.BOX]), about.mirror * about.metres)
        stated = str(row.get("movable", "")).lower()
        names = (name, str(row.get("name") or name), str(row.get("category", "")))
        can_move = stated in _TRUE if stated else len(rows) > 1
        tracks.append(streams.ObjectTrack(*names, *_poses(about, poses, rows), low, high, can_move))
    return tuple(tracks)


def _corners(box: Float[np.ndarray, "6"], turn: Float[np.ndarray, "3 3"]) -> _Box:
    """Return the lower and the upper corner of a box along other axes."""
    corners = box.reshape(2, 3) @ turn.T
    return corners.min(axis=0), corners.max(axis=0)


def _events(
    readings: Readings, recording: streams.Recording, span: tuple[float, float], thresholds: Mapping[str, float]
) -> tuple[list[streams.AnnotatedEvent], list[streams.UnreadableEntry]]:
    """Return the events that are listed, and the rows that cannot be read."""
    about = readings.about
    path = readings.events_file
    names = {track.object_id: track.name for track in recording.objects}
    if "objects" in readings.tables:
        listed = readings.tables["objects"].columns
        names |= {key: name or key for key, name in zip(listed["object_id"].tolist(), listed["name"].tolist())}
    first = span[0] - SEVERAL_SENSORS
    last = span[1] + SEVERAL_SENSORS

    def numbers(row: Mapping[str, str], *columns: str) -> Float[np.ndarray, " k"] | None:
        texts = [row.get(column, "") for column in columns]
        if all(text in ("", "nan") for text in texts):
            return None
        values = np.array([float(text) for text in texts])
        require(path, (np.isfinite(values).all(), "", f"numbers in {', '.join(columns)}", ", ".join(texts), ""))
        return values

    def read_event(entry: tuple[str, Mapping[str, str]]) -> streams.AnnotatedEvent:
        key, row = entry
        # An object is meant by its id, or by a name that one object alone has.
        name = row["object"]
        same = [each for each, label in names.items() if label == name]
        name = same[0] if name not in names and len(same) == 1 else name
        time = numbers(row, "time")
        frame = numbers(row, "frame")
        if time is not None:
            instant = float(time[0]) * about.seconds
        elif frame is not None and about.video is not None:
            instant = about.video.start * about.seconds + float(frame[0]) / about.video.fps
        else:
            instant = float("nan")
        action = row["action"].lower()
        hand = row.get("hand", "").lower()
        point = numbers(row, *own.POINT)
        box = numbers(row, *own.BOX)
        upright = box is None or bool((box[:3] <= box[3:]).all())
        known = f"an object of the recording.{did_you_mean(name, names)}".rstrip(".")
        require(
            path,
            (action in ("pick", "put"), "", "the action 'pick' or 'put'", f"'{action}'", ""),
            (hand in ("left", "right", ""), "", "the hand 'left', 'right' or nothing", f"'{hand}'", ""),
            (name and "/" not in name, "", "an object, without '/' in its name", f"'{name}'", ""),
            (name in names or not names, "", known, f"'{name}'", ""),
            (np.isfinite(instant), "", "a time, or a frame and [video]", "neither", ""),
            (first <= instant <= last, "", f"a time from {first:.1f} to {last:.1f} s", f"{instant:.3f} s", ""),
            (upright, "", "a box whose min_… are not above its max_…", f"{box}", ""),
        )
        # Without a place of its own an event is where the tracked object rests.
        corners = None if box is None else _corners(box, about.turn * about.metres)
        if box is None and point is None:
            rest = instant + thresholds["rest_window"] * (-1 if action == "pick" else 1)
            corners = _box_at(recording, name, rest, thresholds["longest_unseen_rest"])
        low, high = corners or (None, None)
        location = None if corners is None else (corners[0] + corners[1]) / 2
        location = location if point is None else about.points(point)
        side, source = (hand or None, "annotated" if hand else None)
        if not hand and location is not None:
            wrists = streams.wrists_at(recording.hands, recording.body, instant)
            side, source = streams.reaching_hand(wrists, location)
        told = (key, action, name, names.get(name, name), instant, location, low, high, side, None, source)
        return streams.AnnotatedEvent(*told)

    rows = {key: (key, row) for key, row in readings.events.items()}
    read, unreadable = read_entries(path, rows, read_event, _EVENT)
    return list(read.values()), unreadable


def _box_at(recording: streams.Recording, object_id: str, time: float, longest: float) -> _Box | None:
    """Return the corners of an object's box; None where it was not tracked within ``longest`` seconds of the time."""
    for track in recording.objects:
        if track.object_id == object_id and track.valid.any():
            unseen = np.abs(track.times[track.valid] - time).min()
            if len(track.times) == 1 or unseen <= longest:
                low, high = track.world_box(*track.pose_at(np.array([time])))
                return low[0], high[0]
    return None
