"""Converts the content of one plain recording to a :class:`Recording`; the only place where units and axes change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
from prbench.representation.converters import check_sides, to_y_up

Points = Float[np.ndarray, "n 3"]
Rows = Int[np.ndarray, " n"]
_GAZE = ("dx", "dy", "dz")
_ORIGIN = ("ox", "oy", "oz")
_TRUE = ("true", "yes", "1")
_NO_EVENTS = "no events: write an events table, or object_poses and the wrists (or a body) in which they are found"


@dataclass(frozen=True)
class World:
    """Turns the world that a recording states into ours.

    A left-handed world is mirrored, and so are the axes of each rigid body in it: by their x.

    Attributes:
        about: What the recording states.
        turn: Our axes from the stated ones.
        mirror: A rigid body's axes from the stated ones.
    """

    about: own.About
    turn: Float[np.ndarray, "3 3"]
    mirror: Float[np.ndarray, "3 3"]

    @classmethod
    def of(cls, about: own.About) -> World:
        """Return the world that a recording states."""
        is_left = about.axes.handed == "left"
        turn = to_y_up(np.eye(3), up=about.axes.up, left_handed=is_left).T
        return cls(about, turn, np.diag([-1.0 if is_left else 1.0, 1.0, 1.0]))

    @property
    def metres(self) -> float:
        """Metres a unit of length."""
        return own.LENGTH_UNITS[self.about.units.length]

    @property
    def head_from_cpf(self) -> Float[np.ndarray, "3 3"]:
        """Axes of the head's pose from left, up and forward of the face."""
        axes = {"x": 0, "y": 1, "z": 2}
        head = self.about.head
        up, forward = (
            self.mirror[:, axes[axis[-1]]] * (-1.0 if axis[0] == "-" else 1.0) for axis in (head.up, head.forward)
        )
        return np.column_stack([np.cross(up, forward), up, forward])

    def times(self, table: Table, rows: Rows) -> Float[np.ndarray, " n"]:
        """Return the times of some rows, seconds."""
        return table.columns["time"][rows] * own.TIME_UNITS[self.about.units.time]

    def points(self, positions: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        """Return positions in our world, metres."""
        return positions @ self.turn.T * self.metres

    def boxes(self, low: Points, high: Points, axes: Float[np.ndarray, "3 3"]) -> tuple[Points, Points]:
        """Return the corners of boxes along other axes, metres."""
        corners = np.stack([low @ axes.T, high @ axes.T]) * self.metres
        return corners.min(axis=0), corners.max(axis=0)

    def poses(
        self, table: Table, rows: Rows
    ) -> tuple[Float[np.ndarray, " n"], Points, Float[np.ndarray, "n 4"], Bool[np.ndarray, " n"]]:
        """Return times, positions, rotations and validity of some rows of a table of poses."""
        valid = table.measured(own.POINT)[rows]
        rotation = np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        if own.QUATERNION[0] in table.columns:
            valid &= table.measured(own.QUATERNION)[rows]
            rotation[valid] = table.vectors(own.QUATERNION)[rows][valid]
        matrices = self.turn @ Rotation.from_quat(rotation, scalar_first=True).as_matrix() @ self.mirror
        turned = Rotation.from_matrix(matrices).as_quat(scalar_first=True)
        position = streams.hold_neighbours(self.points(table.vectors(own.POINT)[rows]), valid)
        return self.times(table, rows), position, turned, valid


def recording_from_tables(readings: Readings, manifest: Manifest, found: RecordingFiles) -> streams.Recording:
    """Return the streams of a plain recording, whichever it has.

    Args:
        readings: Content of its files.
        manifest: Source of bodies where the recording states none, head tilt and thresholds.
        found: Its name and files, for messages.

    Raises:
        InputFileError: if tables contradict one another.
        StreamsDoNotOverlap: if two tables share no instant.
    """
    about = readings.about
    tables = readings.tables
    world = World.of(about)
    messages: list[str] = []
    head = streams.NO_POSES
    if (table := tables.get("head")) is not None:
        times, position, rotation, valid = world.poses(table, np.arange(len(table.columns["time"])))
        facing = Rotation.from_quat(rotation, scalar_first=True) * Rotation.from_matrix(world.head_from_cpf)
        head = streams.PoseStream(times, position, facing.as_quat(scalar_first=True), valid)
    gaze = streams.NO_GAZE
    if (table := tables.get("gaze")) is not None:
        gaze = _gaze(world, table, head, manifest.thresholds["longest_head_gap"])
        if lost := int((table.measured(_GAZE) & ~gaze.valid).sum()):
            messages.append(f"gaze: {lost} of {len(gaze.times)} samples have no origin, or no pose of the head nearby")
    body = None
    if (table := tables.get("body")) is not None:
        body = _body(world, table)
        if lost := int((~body.valid).sum()):
            messages.append(f"body: {lost} of {len(body.times)} frames lack joints or change their bones: left out")
    hands = () if body is None else body.wrists()
    if (table := tables.get("wrists")) is not None:
        sides = np.array([text.lower() for text in table.columns["side"]])
        hands = tuple(_wrist(world, table, side, np.flatnonzero(sides == side)) for side in streams.SIDES)
    objects = _objects(world, tables)
    moving = [track.times for track in objects if len(track.times) > 1]
    clocks = {"head": head.times, "gaze": gaze.times, "body": None if body is None else body.times}
    clocks["wrists"] = np.sort(np.concatenate([np.zeros(0), *(hand.times for hand in hands)]))
    clocks["objects"] = np.sort(np.concatenate([np.zeros(0), *moving]))
    ranges = stream_ranges(clocks)
    if ranges:
        require_overlap(ranges, recording=found.recording_id)
    span = (min(first for first, _ in ranges.values()), max(last for _, last in ranges.values())) if ranges else None
    listed, unreadable = _events(world, readings, _Around(span, objects, hands, body, manifest.thresholds))
    times = [event.event_time for event in listed]
    if not readings.events and not (moving and hands):
        messages.append(_NO_EVENTS)
    to_metres = np.eye(4)
    to_metres[:3, :3] = world.turn * world.metres
    return streams.Recording(
        dataset=found.dataset,
        recording_id=found.recording_id,
        participant_id=about.participant,
        pose_source="none" if body is None else about.body.source or manifest.body.pose_source,
        head_tilt_deg=manifest.body.head_tilt_deg,
        span=span or (min(times, default=0.0), max(times, default=0.0)),
        gaze=gaze,
        camera=streams.NO_POSES,
        head=head,
        body=body,
        hands=hands,
        objects=objects,
        annotated_events=tuple(listed),
        world_from_source=to_metres,
        messages=tuple(messages),
        unreadable=tuple(unreadable),
    )


def _gaze(world: World, table: Table, head: streams.PoseStream, longest: float) -> streams.GazeStream:
    """Return the gaze rays; what is stated in the axes of the head needs its pose, and so do rays without origin."""
    times = world.times(table, np.arange(len(table.columns["time"])))
    valid = table.measured(_GAZE)
    direction = np.where(valid[:, None], table.vectors(_GAZE), [0.0, 0.0, 1.0])
    has_origin = _ORIGIN[0] in table.columns
    offset = table.vectors(_ORIGIN) if has_origin else np.zeros((len(times), 3))
    valid &= ~np.isnan(offset).any(axis=1)
    offset = np.nan_to_num(offset)
    in_head = world.about.gaze.frame == "head"
    needs = "a head table beside it: gaze is in the axes of the head" if in_head else f"{', '.join(_ORIGIN)}, or a head"
    require(table.path, (len(head.times) or (has_origin and not in_head), "", needs, "none", "Add the head's poses."))
    origin = world.points(offset)
    direction = direction @ world.turn.T if not in_head else direction
    if in_head or not has_origin:
        position, rotation = head.pose_at(times)
        valid &= covered(head.times, head.valid, times, max_gap=longest)
        facing = Rotation.from_quat(rotation, scalar_first=True) * Rotation.from_matrix(world.head_from_cpf.T)
        origin = position + facing.apply(offset @ world.mirror.T * world.metres)
        direction = facing.apply(direction @ world.mirror.T) if in_head else direction
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return streams.GazeStream(times, streams.hold_neighbours(origin, valid), direction, valid)


def _body(world: World, table: Table) -> streams.BodyStream:
    skeleton = world.about.body.map
    times = world.times(table, np.arange(len(table.columns["time"])))
    joints = world.points(table.vectors(own.body_columns(skeleton)).reshape(len(times), -1, 3))
    joints = skeleton.to_22(joints, source=table.path)
    valid = streams.plausible_body_frames(times, joints)
    if valid.any():
        try:
            check_sides(joints[valid], source=table.path)
        except InputFileError as error:
            remedy = f"In a left-handed world (Unity, Unreal) say axes.handed = 'left' in {own.ABOUT_FILE}; else left"
            remedy += " and right joints are exchanged."
            about = {"expected": error.expected, "found": error.found, "remedy": remedy}
            raise InputFileError(table.path, error.where, **about) from error
    return streams.BodyStream(times, streams.hold_neighbours(joints, valid), valid)


def _wrist(world: World, table: Table, side: streams.Side, rows: Rows) -> streams.HandStream:
    valid = table.measured(own.POINT)[rows]
    points = streams.hold_neighbours(world.points(table.vectors(own.POINT)[rows]), valid)
    return streams.HandStream(side, "wrist", world.times(table, rows), points[:, None], valid)


def _objects(world: World, tables: Mapping[str, Table]) -> tuple[streams.ObjectTrack, ...]:
    """Return a track of each object of which poses are known."""
    poses = tables.get("object_poses")
    if poses is None:
        return ()
    ids = poses.columns["object_id"].astype(str)
    listed = tables.get("objects")
    known = {name: {"name": name} for name in np.unique(ids).tolist()}
    if listed is not None:
        names = listed.columns["object_id"].astype(str).tolist()
        twice = first_repeated(names)
        require(listed.path, (twice is None, "column 'object_id'", "each object once", f"'{twice}' twice", ""))
        strange = ~np.isin(ids, names)
        remedy = "" if not strange.any() else did_you_mean(ids[strange.argmax()], names).strip()
        poses.refuse(strange, "object_id", "an object of the objects table", ids.__getitem__, remedy)
        known = {name: {key: column[row] for key, column in listed.columns.items()} for row, name in enumerate(names)}
    order = np.argsort(ids, kind="stable")
    tracks = []
    for name, about in known.items():
        rows = order[np.searchsorted(ids[order], name) : np.searchsorted(ids[order], name, side="right")]
        if not len(rows):
            continue  # only its name is known
        corners = np.nan_to_num([[about.get(column, 0.0) for column in own.BOX]]).reshape(2, 1, 3)
        low, high = world.boxes(*corners, world.mirror)
        stated = str(about.get("movable", "")).lower()
        about = (name, str(about["name"]) or name, str(about.get("category", "")))
        can_move = stated in _TRUE if stated else len(rows) > 1
        tracks.append(streams.ObjectTrack(*about, *world.poses(poses, rows), low[0], high[0], can_move))
    return tuple(tracks)


@dataclass(frozen=True)
class _Around:
    """What the streams of a recording tell of its events.

    Attributes:
        span: First and last time of the streams, seconds; None without any.
        thresholds: Those of the manifest.
    """

    span: tuple[float, float] | None
    objects: tuple[streams.ObjectTrack, ...]
    hands: tuple[streams.HandStream, ...]
    body: streams.BodyStream | None
    thresholds: Mapping[str, float]

    def resting_place(self, name: str, action: str, time: float) -> tuple[Points, Points] | None:
        """Return the corners of a tracked object's box just before a pick or after a put; None while it is unseen."""
        track = next((each for each in self.objects if each.object_id == name and each.valid.any()), None)
        instant = time + self.thresholds["rest_window"] * (-1 if action == "pick" else 1)
        if track is None:
            return None
        unseen = np.abs(track.times[track.valid] - instant).min()
        if len(track.times) > 1 and unseen > self.thresholds["longest_unseen_rest"]:
            return None
        return track.world_box(*track.pose_at(np.array([instant])))


def _events(
    world: World, readings: Readings, around: _Around
) -> tuple[list[streams.AnnotatedEvent], list[streams.UnreadableEntry]]:
    """Return the events that are listed, and the rows that cannot be read."""
    path = readings.events_file
    about = readings.about
    listed = readings.tables.get("objects")
    names = {track.object_id: track.name for track in around.objects}
    if listed is not None:
        columns = (listed.columns[name].astype(str).tolist() for name in ("object_id", "name"))
        names |= {key: name or key for key, name in zip(*columns, strict=True)}

    def numbers(row: Mapping[str, str], columns: Sequence[str]) -> Float[np.ndarray, " k"] | None:
        """Return the numbers of a group of columns; None where it is empty or not there."""
        texts = [row.get(column, "") for column in columns]
        if not any(texts):
            return None
        values = np.array([_number(text) for text in texts])
        found = ", ".join(f"'{text}'" for text in texts)
        require(path, (np.isfinite(values).all(), "", f"numbers in {', '.join(columns)}", found, ""))
        return values

    def read_event(entry: tuple[str, Mapping[str, str]]) -> streams.AnnotatedEvent:
        key, row = entry
        action = row["action"].lower()
        hand = row.get("hand", "").lower()
        # The place in time: stated, or by a frame of the video.
        stated = numbers(row, ["time"])
        frame = numbers(row, ["frame"])
        if stated is None and frame is not None and about.video is not None:
            stated = about.video.start + frame / about.video.fps / own.TIME_UNITS[about.units.time]
        time = np.nan if stated is None else float(stated[0]) * own.TIME_UNITS[about.units.time]
        start, end = around.span or (time, time)
        slack = SEVERAL_SENSORS
        # An object is meant by its id, or by a name that only one has.
        same = [each for each, name in names.items() if name == row["object"]]
        name = same[0] if row["object"] not in names and len(same) == 1 else row["object"]
        near = did_you_mean(name, names)
        require(
            path,
            (action in ("pick", "put"), "", "an action 'pick' or 'put'", f"'{row['action']}'", ""),
            (hand in ("left", "right", ""), "", "a hand 'left', 'right' or nothing", f"'{row['hand']}'", ""),
            (name and "/" not in name, "", "an object without '/' in its name", f"'{name}'", ""),
            (name in names or not names, "", f"an object of the recording.{near}".rstrip("."), f"'{name}'", ""),
            (np.isfinite(time), "", "a time, or a frame and [video]", "neither", ""),
            (start - slack <= time <= end + slack, "", f"a time from {start:.3f} to {end:.3f} s", f"{time:.3f} s", ""),
        )
        # Where: as listed, else where the tracked object rests.
        point = numbers(row, own.POINT)
        corners = numbers(row, own.BOX)
        box = around.resting_place(name, action, time) if point is None and corners is None else None
        if corners is not None:
            require(path, ((corners[:3] <= corners[3:]).all(), "", "min_… not above max_…", corners.tolist(), ""))
            box = world.boxes(corners[None, :3], corners[None, 3:], world.turn)
        location = None if point is None else world.points(point)
        low, high = (None, None) if box is None else (box[0][0], box[1][0])
        if low is not None and high is not None and location is None:
            location = (low + high) / 2
        side, source = (hand or None, "annotated" if hand else None)
        if not hand and location is not None:
            side, source = streams.reaching_hand(streams.wrists_at(around.hands, around.body, time), location)
        label = names.get(name, name)
        return streams.AnnotatedEvent(key, action, name, label, time, location, low, high, side, None, source)

    read, unreadable = read_entries(path, {key: (key, row) for key, row in readings.events.items()}, read_event)
    return list(read.values()), unreadable


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
