"""Converts the content of one plain recording to a :class:`Recording`; the only place where units and axes change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench import recording as streams
from prbench.errors import did_you_mean
from prbench.files.arrays import first_repeated
from prbench.files.bounded import require
from prbench.geometry.timelines import covered, require_overlap, stream_ranges
from prbench.protocol.manifests import Manifest
from prbench.readers.extents import SEVERAL_SENSORS
from prbench.readers.files import read_entries
from prbench.readers.found import RecordingFiles
from prbench.readers.own import format as own
from prbench.readers.own.files import Readings, Table
from prbench.representation.converters import front_of_legs

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
    head = _head(about, tables["head"]) if "head" in tables else streams.NO_POSES
    longest = manifest.thresholds["longest_head_gap"]
    gaze = _gaze(about, tables["gaze"], head, longest) if "gaze" in tables else streams.NO_GAZE
    body = _body(about, tables["body"]) if "body" in tables else None
    hands = () if body is None else body.wrists()
    if "wrists" in tables:
        hands = tuple(_wrist(about, tables["wrists"], side) for side in streams.SIDES)
    objects = _objects(about, tables)
    moving = {f"object {track.object_id}": track.times for track in objects if len(track.times) > 1}
    lost = {"gaze samples have no pose of the head nearby": ~gaze.valid}
    lost["body frames lack joints, change their bones, or jump"] = np.zeros(0) if body is None else ~body.valid
    messages = [f"{rows.sum():.0f} {text}" for text, rows in lost.items() if rows.any()]
    messages += [] if readings.events or (moving and hands) else [_NO_EVENTS]
    # Objects and hands may be out of sight for long; the other streams last as long as the recording.
    lasting = stream_ranges({"head": head.times, "gaze": gaze.times, "body": None if body is None else body.times})
    if lasting:
        require_overlap(lasting, recording=found.recording_id)
    ranges = lasting | stream_ranges({**moving, **{f"{hand.side} wrist": hand.times for hand in hands}})
    ends = [time for pair in ranges.values() for time in pair]
    span = (min(ends, default=0.0), max(ends, default=0.0))
    source = "none" if body is None else about.body.source or manifest.body.pose_source
    about_it = (found.dataset, found.recording_id, about.participant, source, manifest.body.head_tilt_deg)
    known = streams.Recording(*about_it, span, gaze, streams.NO_POSES, head, body, hands, objects)
    events, unreadable = _events(readings, known, manifest.thresholds)
    ends = ends or [event.event_time for event in events] or [0.0]
    told = {"messages": tuple(messages), "annotated_events": tuple(events), "unreadable": tuple(unreadable)}
    if about.video is not None:
        start = about.video.start * about.seconds
        shown = np.array([start, max(*ends, start + 1 / about.video.fps)])
        told["video"] = streams.Video(shown, (shown - start) * about.video.fps, about.video.fps)
    world_from_source = np.eye(4)
    world_from_source[:3, :3] = about.turn * about.metres
    return replace(known, span=(min(ends), max(ends)), world_from_source=world_from_source, **told)


def _poses(about: own.About, table: Table, rows: Int[np.ndarray, " n"] | slice = slice(None)) -> _Poses:
    """Return times, positions, rotations and validity of some rows of a table of poses."""
    times = table.columns["time"][rows] * about.seconds
    matrices = np.broadcast_to(about.turn @ about.mirror, (len(times), 3, 3))
    if own.QUATERNION[0] in table.columns:
        stated = Rotation.from_quat(table.vectors(own.QUATERNION)[rows], scalar_first=True)
        matrices = about.turn @ stated.as_matrix() @ about.mirror
    turned = Rotation.from_matrix(matrices).as_quat(scalar_first=True)
    return times, about.points(table.vectors(own.POINT)[rows]), turned, np.ones(len(times), dtype=bool)


def _head(about: own.About, table: Table) -> streams.PoseStream:
    times, position, rotation, valid = _poses(about, table)
    facing = Rotation.from_quat(rotation, scalar_first=True) * Rotation.from_matrix(about.head_from_cpf)
    return streams.PoseStream(times, position, facing.as_quat(scalar_first=True), valid)


def _gaze(about: own.About, table: Table, head: streams.PoseStream, longest: float) -> streams.GazeStream:
    """Return the gaze rays; directions in the axes of the head need its pose, and so do rays without an origin."""
    times = table.columns["time"] * about.seconds
    in_head = about.gaze.frame == "head"
    has_origin = own.ORIGIN[0] in table.columns
    needs = "a head table beside it, because gaze.frame is 'head'" if in_head else "ox, oy, oz, or a head table"
    require(table.path, (len(head.times) or (has_origin and not in_head), "", needs, "none", "Add the head's poses."))
    stated = table.vectors(own.GAZE)
    direction = stated / np.linalg.norm(stated, axis=1, keepdims=True)
    offset = table.vectors(own.ORIGIN) if has_origin else np.zeros((len(times), 3))
    if has_origin and not in_head:
        valid = np.ones(len(times), dtype=bool)
        return streams.GazeStream(times, about.points(offset), direction @ about.turn.T, valid)
    position, rotation = head.pose_at(times)
    facing = Rotation.from_quat(rotation, scalar_first=True) * Rotation.from_matrix(about.head_from_cpf.T)
    origin = position + facing.apply(offset @ about.mirror) * about.metres
    direction = facing.apply(direction @ about.mirror) if in_head else direction @ about.turn.T
    return streams.GazeStream(times, origin, direction, covered(head.times, head.valid, times, max_gap=longest))


def _body(about: own.About, table: Table) -> streams.BodyStream:
    times = table.columns["time"] * about.seconds
    native = about.points(table.vectors(own.body_columns(about)).reshape(len(times), -1, 3))
    joints = own.SKELETONS[about.body.skeleton].to_22(native, source=table.path)
    valid = streams.plausible_body_frames(times, joints)
    # A mean cosine below -0.3 between the front of the legs and that of the hips is no twist of a whole recording.
    front = front_of_legs(joints[valid]) if valid.any() else None
    remedy = "Left and right joints are exchanged, or the world is left-handed: axes.handed = 'left' (Unity, Unreal)."
    ahead = "feet and knees that point to the body's front"
    require(table.path, (front is None or front > -0.3, "", ahead, "those of a mirrored body", remedy))
    return streams.BodyStream(times, streams.hold_neighbours(joints, valid), valid)


def _wrist(about: own.About, table: Table, side: streams.Side) -> streams.HandStream:
    rows = np.array([text.lower() == side for text in table.columns["side"]], dtype=bool)
    times = table.columns["time"][rows] * about.seconds
    points = about.points(table.vectors(own.POINT)[rows])
    return streams.HandStream(side, "wrist", times, points[:, None], np.ones(len(times), dtype=bool))


def _objects(about: own.About, tables: Mapping[str, Table]) -> tuple[streams.ObjectTrack, ...]:
    """Return a track of each object of which poses are known."""
    if "object_poses" not in tables:
        return ()
    poses = tables["object_poses"]
    ids = poses.columns["object_id"].astype(str)
    known: dict[str, Mapping[str, Any]] = {name: {} for name in np.unique(ids).tolist()}
    if "objects" in tables:
        listed = tables["objects"]
        names = listed.columns["object_id"].astype(str).tolist()
        twice = first_repeated(names)
        strange = next((name for name in known if name not in names), "")
        near = did_you_mean(strange, names).strip()
        require(listed.path, (twice is None, "column 'object_id'", "each object once", f"'{twice}' twice", ""))
        require(poses.path, (not strange, "column 'object_id'", f"ids of {listed.path.name}", f"'{strange}'", near))
        known = {name: {key: each[row] for key, each in listed.columns.items()} for row, name in enumerate(names)}
    tracks = []
    for name, row in known.items():
        rows = np.flatnonzero(ids == name)
        if len(rows):  # of others only the name is known
            box = np.nan_to_num([row.get(column, 0.0) for column in own.BOX])
            stated = str(row.get("movable", "")).lower()
            can_move = stated in _TRUE if stated else len(rows) > 1
            names = (name, str(row.get("name") or name), str(row.get("category", "")))
            corners = _corners(box, about.mirror * about.metres)
            tracks.append(streams.ObjectTrack(*names, *_poses(about, poses, rows), *corners, can_move))
    return tuple(tracks)


def _corners(box: Float[np.ndarray, "6"], turn: Float[np.ndarray, "3 3"]) -> _Box:
    """Return the lower and the upper corner of a box along other axes."""
    corners = box.reshape(2, 3) @ turn.T
    return corners.min(axis=0), corners.max(axis=0)


def _events(
    readings: Readings, recording: streams.Recording, thresholds: Mapping[str, float]
) -> tuple[list[streams.AnnotatedEvent], list[streams.UnreadableEntry]]:
    """Return the events that are listed, and the rows that cannot be read."""
    about = readings.about
    path = readings.events_file
    video = about.video or own.Video(start=np.nan, fps=1.0)
    names = {track.object_id: track.name for track in recording.objects}
    if "objects" in readings.tables:
        listed = readings.tables["objects"].columns
        names |= {key: name or key for key, name in zip(listed["object_id"].tolist(), listed["name"].tolist())}
    slack = SEVERAL_SENSORS if np.ptp(recording.span) else np.inf
    first, last = np.add(recording.span, (-slack, slack))

    def read_event(entry: tuple[str, Mapping[str, str]]) -> streams.AnnotatedEvent:
        key, row = entry

        def numbers(*columns: str) -> Float[np.ndarray, " k"]:
            values = np.array([float(row.get(column) or "nan") for column in columns])
            complete = np.isfinite(values).all() or np.isnan(values).all()
            require(path, (complete, "", f"numbers in {', '.join(columns)}, or nothing", values.tolist(), ""))
            return values

        # An object is meant by its id, or by a name that one object alone has.
        name = row["object"]
        same = [each for each, label in names.items() if label == name]
        name = same[0] if name not in names and len(same) == 1 else name
        known = f"an object of the recording.{did_you_mean(name, [*names, *names.values()])}".rstrip(".")
        action = row["action"].lower()
        hand = row.get("hand", "").lower()
        instant = float(numbers("time")[0] * about.seconds)
        if np.isnan(instant):
            instant = float(video.start * about.seconds + numbers("frame")[0] / video.fps)
        require(
            path,
            (action in ("pick", "put"), "", "the action 'pick' or 'put'", f"'{action}'", ""),
            (hand in ("left", "right", ""), "", "the hand 'left', 'right' or nothing", f"'{hand}'", ""),
            (name and "/" not in name, "", "an object, without '/' in its name", f"'{name}'", ""),
            (name in names or not names, "", known, f"'{name}'", ""),
            (first <= instant <= last, "", f"a time from {first:.1f} to {last:.1f} s", f"{instant:.3f} s", ""),
        )
        # Without a place of its own an event is where the tracked object rests.
        point = about.points(numbers(*own.POINT))
        box = numbers(*own.BOX)
        corners = None if np.isnan(box[0]) else _corners(box, about.turn * about.metres)
        if corners is None and np.isnan(point[0]):
            rest = instant + thresholds["rest_window"] * (-1 if action == "pick" else 1)
            corners = _box_at(recording, name, rest, thresholds["longest_unseen_rest"])
        low, high = corners or (None, None)
        middle = None if corners is None else (corners[0] + corners[1]) / 2
        location = middle if np.isnan(point[0]) else point
        side, source = (hand or None, "annotated" if hand else None)
        if not hand and location is not None:
            side, source = streams.reaching_hand(streams.wrists_at(recording.hands, recording.body, instant), location)
        told: Any = (key, action, name, names.get(name, name), instant, location, low, high, side, None, source)
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
