"""``Recording`` and its streams: the one form that every reader yields and all of curation works on.

One clock, one frame.

World frame: metres, Y up, right-handed. Times: seconds on the recording's clock, strictly increasing within a stream;
every stream has its own. Quaternions: w x y z, Hamilton. Values are finite everywhere; where nothing was measured the
``valid`` mask is False and the value is a harmless filler. Numbers that no recording can hold (a wrist 9e29 m away, a
clock that jumps by years) are refused here, so that no reader has to think of them.

The hand that reached is the one whose wrist is nearest to the place of an event; none where the wrists do not decide. A
wrist is known from hand tracking, else from the body. Glasses lose a hand more often than a body estimate does, and the
one that they lose may be the one that reached: so a single known wrist counts only close to the place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import RecordingUnusable
from prbench.files.arrays import first_repeated, require_near, require_times, require_unit_length
from prbench.geometry.skeleton import WRISTS, bone_lengths
from prbench.geometry.timelines import covered, interpolate, nearest_index, slerp
from prbench.limits import FARTHEST_POSITION, LARGEST_OBJECT
from prbench.shown import quoted

# Sources of bodies that were computed from whole tracks of the head: a frame may carry later head motion
# (docs/specification/motion-prediction.md#from-recordings-to-windows).
ESTIMATED = frozenset({"egoallo", "three-point"})
_ENTRIES_NAMED = 3  # unreadable entries that a message names


@dataclass(frozen=True)
class PublishedTrack:
    """One segment at 30 frames a second, every frame of it, measured or not. World, metres, Y up.

    Attributes:
        name: Unique within the recording.
        published_split: ``train``, ``test`` or ``unused`` where the files themselves tell it, else empty.
        valid: Frames whose pose was measured or filled in; elsewhere a neighbour's stands.
        filled: Frames whose pose was filled in from frames on both sides.
        body: The 22 joints of the same frames, from which the head's direction is computed.
        gaze_measured: Frames with a measurement of their own, neither held nor interpolated.
    """

    name: str
    published_split: str
    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n joints 3"]
    valid: Bool[np.ndarray, " n"]
    filled: Bool[np.ndarray, " n"]
    body: Float[np.ndarray, "n 22 3"]
    gaze: Float[np.ndarray, "n 3"]
    gaze_measured: Bool[np.ndarray, " n"]


Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
Action = Literal["pick", "put"]
ContactPoint = Literal["wrist", "middle_finger_base", "hand_vertex"]
# Source of an event's hand: the dataset, the in-hand rule's contact points, a tracked wrist, the body's wrist, which
# wrist moved more before the event, or a person's correction.
HandSource = Literal["annotated", "contact", "tracked", "body", "movement", "person"]


def _check_stream(name: str, times: np.ndarray, *columns: np.ndarray) -> None:
    # Guaranteed by readers, hence asserts; what users hand in is checked where it is read.
    assert times.ndim == 1, "one time a row"
    assert (np.diff(times) > 0).all(), "times must increase strictly; readers check their files"
    assert all(len(column) == len(times) for column in columns), "one row a time"
    assert all(np.isfinite(column).all() for column in columns), "streams hold no NaN; readers mask instead"
    require_times(name, times)


def _check_poses(name: str, stream: PoseStream | ObjectTrack) -> None:
    _check_stream(name, stream.times, stream.position, stream.rotation, stream.valid)
    require_near(name, stream.position, stream.valid, farthest=FARTHEST_POSITION)
    require_unit_length(f"rotation of {name}", stream.rotation, stream.valid)


def _pose_at(
    self: PoseStream | ObjectTrack, query: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 4"]]:
    """Return the position and rotation interpolated between valid samples, end values held beyond them."""
    # Without a valid sample the fillers stand in: callers mask the result, and no caller has to treat this case.
    usable = self.valid if self.valid.any() else np.ones_like(self.valid)
    times = self.times[usable]
    return interpolate(times, self.position[usable], query), slerp(times, self.rotation[usable], query)


def _require_distinct(what: str, ids: Sequence[str]) -> None:
    """Refuse one id for two things: which of them is meant later would depend on their order."""
    if (repeated := first_repeated(ids)) is not None:
        raise RecordingUnusable(f"{what}: expected different ids, found '{quoted(repeated)}' twice.")


@dataclass(frozen=True)
class GazeStream:
    """The wearer's gaze: rays in the world.

    Attributes:
        origin: Between the eyes (central pupil frame).
        direction: Unit vectors.
    """

    times: Float[np.ndarray, " n"]
    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_stream("gaze", self.times, self.origin, self.direction, self.valid)
        require_near("gaze origin", self.origin, self.valid, farthest=FARTHEST_POSITION)
        require_unit_length("gaze direction", self.direction, self.valid)


@dataclass(frozen=True)
class PoseStream:
    """A rigid body in the world: ``world = rotation * local + position``."""

    times: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_poses("glasses", self)

    pose_at = _pose_at


# Streams of what nobody measured.
NO_GAZE = GazeStream(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, dtype=bool))
NO_POSES = PoseStream(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0, dtype=bool))


@dataclass(frozen=True)
class BodyStream:
    """The 22 joints of :class:`prbench.geometry.skeleton.Joint`."""

    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_stream("body", self.times, self.joints, self.valid)
        require_near("body", self.joints, self.valid, farthest=FARTHEST_POSITION)

    def wrists(self) -> tuple[HandStream, ...]:
        """Return the body's wrists as hands, for recordings that track none."""
        return tuple(
            HandStream(side, "wrist", self.times, self.joints[:, [wrist]], self.valid)
            for side, wrist in zip(SIDES, WRISTS, strict=True)
        )


@dataclass(frozen=True)
class HandStream:
    """One kind of contact point on one hand: a single point (k = 1) or mesh vertices."""

    side: Side
    contact: ContactPoint
    times: Float[np.ndarray, " n"]
    points: Float[np.ndarray, "n k 3"]
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_stream(f"{self.side} hand", self.times, self.points, self.valid)
        require_near(f"{self.side} hand", self.points, self.valid, farthest=FARTHEST_POSITION)


@dataclass(frozen=True)
class ObjectTrack:
    """One object: its pose over time and its box in its own frame.

    A track of one sample is an object that does not move: its pose holds at all times.

    Attributes:
        object_id: The dataset's own id as text; 16-digit ids do not survive a float.
        box_min: Lower corner in the object's frame; equal to ``box_max`` where the dataset knows points only.
        movable: True where the dataset tracks it; only such objects can be picked up.
        surface: Vertices and triangles of its mesh, in its own frame; only where a reader is asked for them.
    """

    object_id: str
    name: str
    category: str
    times: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    valid: Bool[np.ndarray, " n"]
    box_min: Float[np.ndarray, "3"]
    box_max: Float[np.ndarray, "3"]
    movable: bool
    surface: tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]] | None = None

    def __post_init__(self) -> None:
        name = f"object {quoted(self.name)} ({quoted(self.object_id)})"
        _check_poses(name, self)
        require_near(f"box of {name}", np.stack([self.box_min, self.box_max]), farthest=LARGEST_OBJECT)
        if self.surface is not None:
            require_near(f"surface of {name}", self.surface[0], farthest=LARGEST_OBJECT)

    pose_at = _pose_at

    def world_box(
        self, position: Float[np.ndarray, "m 3"], rotation: Float[np.ndarray, "m 4"]
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """Return the world-aligned boxes (lower, upper corners) around the eight turned corners, one a pose."""
        matrix = np.abs(Rotation.from_quat(rotation, scalar_first=True).as_matrix())
        centre = position + Rotation.from_quat(rotation, scalar_first=True).apply((self.box_min + self.box_max) / 2)
        reach = (matrix * ((self.box_max - self.box_min) / 2)).sum(axis=-1)
        return centre - reach, centre + reach


@dataclass(frozen=True)
class OtherPerson:
    """Somebody else in the scene: hands that may move objects too."""

    person_id: str
    hands: tuple[HandStream, ...]


@dataclass(frozen=True)
class PublishedPriming:
    """The dataset's own result about the priming of an event.

    Attributes:
        prime_time: Time of the prime on the recording's clock, seconds; None unless primed.
        uncertainty: Spacing of the instants at which the dataset looked, seconds.
    """

    outcome: Literal["primed", "not_primed", "excluded"]
    prime_time: float | None
    uncertainty: float = 0.0


@dataclass(frozen=True)
class UnreadableEntry:
    """One entry of an annotation file that could not be read; its neighbours were.

    Attributes:
        file: Name of the file.
        key: Place of the entry in the file.
        expected: What the entry should hold.
        found: What it holds instead.
    """

    file: str
    key: str
    expected: str
    found: str

    def __str__(self) -> str:
        return f"{self.file}, {quoted(self.key)}: expected {self.expected}, found {quoted(self.found)}"


def named_entries(entries: Sequence[UnreadableEntry]) -> str:
    """Return a sentence that counts entries that cannot be read, and names the first few."""
    named = "; ".join(map(str, entries[:_ENTRIES_NAMED]))
    more = " …" if len(entries) > _ENTRIES_NAMED else ""
    return f"entries that cannot be read and are left out: {len(entries)}: {named}{more}"


@dataclass(frozen=True)
class AnnotatedEvent:
    """A pick or put that the dataset itself lists.

    Attributes:
        native_key: The event's identifier in the dataset.
        location: None where the dataset gives no place.
        published_priming: None where the dataset publishes no priming.
        hand_source: None where the hand is unknown.
    """

    native_key: str
    action: Action
    object_id: str
    object_name: str
    event_time: float
    location: Float[np.ndarray, "3"] | None
    box_min: Float[np.ndarray, "3"] | None
    box_max: Float[np.ndarray, "3"] | None
    hand: Side | None = None
    published_priming: PublishedPriming | None = None
    hand_source: HandSource | None = None

    def __post_init__(self) -> None:
        name = f"event {quoted(self.native_key)}"
        require_times(name, np.array([self.event_time], dtype=np.float64))
        for place in (self.location, self.box_min, self.box_max):
            if place is not None:
                require_near(name, place[None], farthest=FARTHEST_POSITION)
        if self.published_priming is not None and self.published_priming.prime_time is not None:
            require_times(f"prime of {name}", np.array([self.published_priming.prime_time], dtype=np.float64))


@dataclass(frozen=True)
class Video:
    """Which frame of the recording's video shows which moment.

    Attributes:
        times: Two or more moments, seconds on the recording's clock, increasing.
        frames: Numbers of the frames that show them, from 0; linear in between.
        fps: Frames a second of the video, by which its own time counts.
    """

    times: Float[np.ndarray, " n"]
    frames: Float[np.ndarray, " n"]
    fps: float

    def told(self, moments: Mapping[str, float | None]) -> dict[str, str]:
        """Return ``<name>_time`` (seconds of the video) and ``<name>_frame`` of each moment that the video shows."""
        said = {}
        for name, time in moments.items():
            if time is not None and self.times[0] - 0.5 / self.fps <= time <= self.times[-1] + 0.5 / self.fps:
                frame = float(np.interp(time, self.times, self.frames))
                said |= {f"{name}_time": f"{frame / self.fps:.3f}", f"{name}_frame": str(round(frame))}
        return said


@dataclass(frozen=True)
class Recording:
    """Everything that one recording tells curation; the class that every reader yields, one at a time.

    Attributes:
        pose_source: Source of the body (``adt-optitrack``, ``egoallo``, …); ``none`` without a body.
        head_tilt_deg: Rest tilt of that body's neck-head bone, degrees
            (docs/specification/humanml3d.md#head-forward-vector).
        span: First and last instant with ground truth, seconds.
        camera: The scene camera of the glasses.
        head: The glasses' central pupil frame: x left, y up, z forward.
        split_group: Recordings with one group share a split (concurrent twins); the recording's own id where it stands
            alone.
        hinged_objects: Ids of doors, drawers and the like, where the dataset says so.
        annotations_alone: True where the events were read without any stream, so that none can be primed.
        has_published_priming: True where the dataset's own priming results are there, whatever they say.
        world_from_source: Maps the scene's own coordinates (meshes, point clouds) into this world frame.
        furniture: Things that stand still and are no part of :attr:`objects`, because the dataset tracks none of them.
        messages: Messages of the reader for the user.
        unreadable: Entries of the annotation files that were left out, because they cannot be read.
        hands_from_glasses: True where the glasses measured the hands, which then lie beside the head at any time.
        shortfalls: One message for each stream that ends before the recording does; its file may be cut off.
        video: The clock of its video; None where the files do not tell it.
    """

    dataset: str
    recording_id: str
    participant_id: str
    pose_source: str
    head_tilt_deg: float
    span: tuple[float, float]
    gaze: GazeStream
    camera: PoseStream
    head: PoseStream
    body: BodyStream | None
    hands: tuple[HandStream, ...]
    objects: tuple[ObjectTrack, ...]
    other_people: tuple[OtherPerson, ...] = ()
    annotated_events: tuple[AnnotatedEvent, ...] = ()
    split_group: str = ""
    hinged_objects: frozenset[str] = frozenset()
    annotations_alone: bool = False
    has_published_priming: bool = False
    world_from_source: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    furniture: tuple[ObjectTrack, ...] = ()
    messages: tuple[str, ...] = ()
    unreadable: tuple[UnreadableEntry, ...] = ()
    shortfalls: tuple[str, ...] = ()
    hands_from_glasses: bool = False
    video: Video | None = None

    def __post_init__(self) -> None:
        start, end = self.span
        object.__setattr__(self, "span", (float(start), float(end)))  # readers take them from arrays
        require_times("ground truth", np.array(self.span, dtype=np.float64))
        _require_distinct("objects", [track.object_id for track in self.objects])
        _require_distinct("events", [f"{event.native_key} ({event.action})" for event in self.annotated_events])
        _require_distinct("entries", [f"{entry.file}, {entry.key}" for entry in self.unreadable])

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return the reader's messages, and one that counts the unreadable entries and names the first few."""
        if not self.unreadable:
            return self.messages
        return (*self.messages, named_entries(self.unreadable))

    def hand_streams(self, contact: ContactPoint) -> tuple[HandStream, ...]:
        """Return the wearer's streams of one kind of contact point."""
        return tuple(stream for stream in self.hands if stream.contact == contact)

    def object(self, object_id: str) -> ObjectTrack:
        """Return the track of one object.

        Raises:
            KeyError: for an id that the recording does not hold.
        """
        for track in self.objects:
            if track.object_id == object_id:
                return track
        raise KeyError(object_id)


_BONE_TOLERANCE = 0.20  # share of the recording's median bone length
_FASTEST_JOINT = 10.0  # m/s
_USUAL_SIZE = 5.0  # metres, all bones of a person after one another
_LONGEST_EXCURSION = 0.1  # seconds; what may be interpolated


def plausible_body_frames(
    times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"]
) -> Bool[np.ndarray, " n"]:
    """Return True for frames that are finite, not all at the origin, keep their bone lengths, and do not jump.

    A frame is implausible when it holds a NaN, when all joints are (0, 0, 0), when a bone differs from the recording's
    median length by more than 20 %, or when it belongs to an excursion: at most 0.1 s between two steps in which
    a joint moves faster than 10 m/s (or between one and an end of the recording). The good frames around it stay valid.

    Args:
        times: Strictly increasing, seconds.
        joints: World frame, metres; may hold NaN.
    """
    shaped = np.isfinite(joints).all(axis=(1, 2)) & ~(np.nan_to_num(joints) == 0).all(axis=(1, 2))
    if not shaped.any():
        return shaped
    lengths = bone_lengths(joints[shaped])
    median = np.median(lengths, axis=0)
    shaped[shaped] = (np.abs(lengths - median) <= _BONE_TOLERANCE * median).all(axis=1)
    index = np.flatnonzero(shaped)
    if len(index) < 3:
        return shaped
    step = np.linalg.norm(np.diff(joints[index], axis=0), axis=-1).max(axis=1) / np.diff(times[index])
    # A body in another unit is kept whole, so that its unit can be told and mended.
    size = float(median.sum())
    step *= _USUAL_SIZE / size if size > 4 * _USUAL_SIZE else 1.0
    # Leave out every short run between fast steps; in a very short recording the longest run is the body itself.
    run = np.concatenate(([0], np.cumsum(step > _FASTEST_JOINT)))
    first = np.flatnonzero(np.diff(run, prepend=-1))
    last = np.append(first[1:], len(run)) - 1
    duration = times[index[last]] - times[index[first]]
    short = duration <= _LONGEST_EXCURSION
    short[np.argmax(duration)] = False
    shaped[index[short[run]]] = False
    return shaped


def hold_neighbours(
    values: Float[np.ndarray, "n *shape"], valid: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n *shape"]:
    """Replace invalid rows by the nearest valid one (of two equally near the earlier); zeros if none is valid."""
    index = np.flatnonzero(valid)
    if len(index) == 0:
        return np.zeros_like(values)
    if len(index) == len(values):
        return values
    return values[index[nearest_index(index.astype(np.float64), np.arange(len(values), dtype=np.float64))]]


# Seconds between two measurements of a wrist that tell where it was in between: hands are tracked at 10 Hz.
_LONGEST_WRIST_GAP = 0.15
# Metres from the place at which the only known wrist is still the one that reached. On synthetic HD-EPIC 99 % of the
# reaching wrists are within 0.17 m of the annotated point.
_FARTHEST_LONE_WRIST = 0.20
# Metres from the place at which the nearer of two known wrists is still the one that reached: a pan is held by its
# handle, and estimated bodies end decimetres from where the hand was.
_FARTHEST_WRIST = 0.40
# Metres by which the other wrist must be farther away. Annotated places are no more exact than that.
LEAST_DIFFERENCE = 0.02


# Position (world, metres) and source of each known wrist at one instant.
Wrists = Mapping[Side, tuple[Float[np.ndarray, "3"], Literal["tracked", "body"]]]


def wrists_at(hands: Sequence[HandStream], body: BodyStream | None, time: float) -> Wrists:
    """Return the wearer's known wrists at one instant, left before right: as tracked, else the body's.

    Args:
        hands: The wearer's hand streams; those that are no wrists are passed over.
        body: The wearer's body, where there is one.
        time: Seconds.
    """
    wrists = {}
    instant = np.array([time])
    for side, joint in zip(SIDES, WRISTS, strict=True):
        sources = [
            (stream.times, stream.points[:, 0], stream.valid, "tracked")
            for stream in hands
            if stream.side == side and stream.contact == "wrist"
        ]
        if body is not None:
            sources.append((body.times, body.joints[:, joint], body.valid, "body"))
        for times, points, valid, source in sources:
            # A wrist is known between two valid samples that are close to each other.
            near = slice(*np.searchsorted(times, [time - _LONGEST_WRIST_GAP, time + _LONGEST_WRIST_GAP]))
            if covered(times[near], valid[near], instant, max_gap=_LONGEST_WRIST_GAP).all():
                usable = valid[near]
                wrists[side] = interpolate(times[near][usable], points[near][usable], instant)[0], source
                break
    return wrists


def reaching_hand(wrists: Wrists, place: Float[np.ndarray, "3"]) -> tuple[Side | None, HandSource | None]:
    """Return the hand whose wrist is nearest to a place, and its source; None and None where wrists do not decide.

    They do not where none is known, where the nearest is too far away, and where both are about equally far.

    Args:
        wrists: Known wrists at the instant of the event, by side.
        place: World, metres.
    """
    distances: dict[Side, float] = {side: float(np.linalg.norm(wrist - place)) for side, (wrist, _) in wrists.items()}
    if not distances:
        return None, None
    nearest = min(distances, key=lambda side: distances[side])
    is_near = distances[nearest] <= (_FARTHEST_LONE_WRIST if len(wrists) == 1 else _FARTHEST_WRIST)
    is_clear = len(wrists) == 1 or abs(distances["left"] - distances["right"]) >= LEAST_DIFFERENCE
    return (nearest, wrists[nearest][1]) if is_near and is_clear else (None, None)
