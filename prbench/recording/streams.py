"""The streams of one recording, on one clock, in one frame.

World frame: metres, Y up, right-handed. Times: seconds on the recording's clock, strictly increasing within a stream;
every stream has its own. Quaternions: w x y z, Hamilton. Values are finite everywhere; where nothing was measured the
``valid`` mask is False and the value is a harmless filler. Numbers that no recording can hold (a wrist 9e29 m away, a
clock that jumps by years) are refused here, so that no reader has to think of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import RecordingUnusable
from prbench.files.arrays import first_repeated, require_near, require_times, require_unit_length
from prbench.geometry.timelines import interpolate, slerp
from prbench.limits import FARTHEST_POSITION, LARGEST_OBJECT
from prbench.shown import quoted

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
Action = Literal["pick", "put"]
ContactPoint = Literal["wrist", "middle_finger_base", "hand_vertex"]
HandSource = Literal["annotated", "contact", "tracked", "body", "movement"]
"""Source of an event's hand: the dataset, the in-hand rule's contact points, a tracked wrist, the body's wrist, or
which wrist moved more before the event."""


def _check_stream(times: np.ndarray, *columns: np.ndarray) -> None:
    # Guaranteed by readers, hence asserts; what users hand in is checked where it is read.
    assert times.ndim == 1, "one time a row"
    assert (np.diff(times) > 0).all(), "times must increase strictly; readers check their files"
    assert all(len(column) == len(times) for column in columns), "one row a time"
    assert all(np.isfinite(column).all() for column in columns), "streams hold no NaN; readers mask instead"


def _check_poses(name: str, stream: PoseStream | ObjectTrack) -> None:
    require_times(name, stream.times)
    require_near(name, stream.position, stream.valid, farthest=FARTHEST_POSITION)
    require_unit_length(f"rotation of {name}", stream.rotation, stream.valid)


def _pose_at(
    stream: PoseStream | ObjectTrack, query: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 4"]]:
    # Without a valid sample the fillers stand in: callers mask the result, and no caller has to treat this case.
    usable = stream.valid if stream.valid.any() else np.ones_like(stream.valid)
    times = stream.times[usable]
    return interpolate(times, stream.position[usable], query), slerp(times, stream.rotation[usable], query)


def _require_distinct(what: str, ids: Sequence[str]) -> None:
    """Refuse one id for two things: which of them is meant later would depend on their order."""
    repeated = first_repeated(ids)
    if repeated is not None:
        raise RecordingUnusable(f"{what}: expected different ids, found '{quoted(repeated)}' twice.")


@dataclass(frozen=True)
class GazeStream:
    """The wearer's gaze: rays in the world."""

    times: Float[np.ndarray, " n"]
    origin: Float[np.ndarray, "n 3"]
    """Between the eyes (central pupil frame)."""
    direction: Float[np.ndarray, "n 3"]
    """Unit vectors."""
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_stream(self.times, self.origin, self.direction, self.valid)
        require_times("gaze", self.times)
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
        _check_stream(self.times, self.position, self.rotation, self.valid)
        _check_poses("glasses", self)

    def pose_at(self, query: Float[np.ndarray, " m"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 4"]]:
        """Position and rotation interpolated between valid samples, end values held beyond them."""
        return _pose_at(self, query)


@dataclass(frozen=True)
class BodyStream:
    """The 22 joints of :class:`prbench.geometry.skeleton.Joint`."""

    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_stream(self.times, self.joints, self.valid)
        require_times("body", self.times)
        require_near("body", self.joints, self.valid, farthest=FARTHEST_POSITION)


@dataclass(frozen=True)
class HandStream:
    """One kind of contact point on one hand: a single point (k = 1) or mesh vertices."""

    side: Side
    contact: ContactPoint
    times: Float[np.ndarray, " n"]
    points: Float[np.ndarray, "n k 3"]
    valid: Bool[np.ndarray, " n"]

    def __post_init__(self) -> None:
        _check_stream(self.times, self.points, self.valid)
        require_times(f"{self.side} hand", self.times)
        require_near(f"{self.side} hand", self.points, self.valid, farthest=FARTHEST_POSITION)


@dataclass(frozen=True)
class ObjectTrack:
    """One object: its pose over time and its box in its own frame.

    A track of one sample is an object that does not move: its pose holds at all times.
    """

    object_id: str
    """The dataset's own id as text; 16-digit ids do not survive a float."""
    name: str
    category: str
    times: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    valid: Bool[np.ndarray, " n"]
    box_min: Float[np.ndarray, "3"]
    """Lower corner in the object's frame; equal to ``box_max`` where the dataset knows points only."""
    box_max: Float[np.ndarray, "3"]
    movable: bool
    """True where the dataset tracks it; only such objects can be picked up."""
    surface: Occluder | None = None
    """Its mesh, in its own frame; only where a reader is asked for meshes."""

    def __post_init__(self) -> None:
        _check_stream(self.times, self.position, self.rotation, self.valid)
        name = f"object {quoted(self.name)} ({quoted(self.object_id)})"
        _check_poses(name, self)
        require_near(f"box of {name}", np.stack([self.box_min, self.box_max]), farthest=LARGEST_OBJECT)
        if self.surface is not None:
            require_near(f"surface of {name}", self.surface.vertices, farthest=LARGEST_OBJECT)

    def pose_at(self, query: Float[np.ndarray, " m"]) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 4"]]:
        """Position and rotation interpolated between valid samples, end values held beyond them."""
        return _pose_at(self, query)

    def world_box(
        self, position: Float[np.ndarray, "m 3"], rotation: Float[np.ndarray, "m 4"]
    ) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]:
        """World-aligned boxes (lower, upper corners) around the eight turned corners, one a pose."""
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
    """The dataset's own result about the priming of an event."""

    outcome: Literal["primed", "not_primed", "excluded"]
    prime_time: float | None
    """On the recording's clock; None unless primed."""
    uncertainty: float = 0.0
    """Spacing of the instants at which the dataset looked, seconds."""


@dataclass(frozen=True)
class Occluder:
    """A triangle mesh that can stand between the eye and a place."""

    name: str
    vertices: Float[np.ndarray, "v 3"]
    """In the world; in the object's own frame where it belongs to an object."""
    faces: Int[np.ndarray, "f 3"]
    object_id: str | None = None
    """The tracked object it moves with; None for the scene."""


@dataclass(frozen=True)
class AnnotatedEvent:
    """A pick or put that the dataset itself lists."""

    native_key: str
    """The event's identifier in the dataset."""
    action: Action
    object_id: str
    object_name: str
    event_time: float
    location: Float[np.ndarray, "3"] | None
    """None where the dataset gives no place."""
    box_min: Float[np.ndarray, "3"] | None
    box_max: Float[np.ndarray, "3"] | None
    hand: Side | None = None
    published_priming: PublishedPriming | None = None
    """None where the dataset publishes no priming."""
    hand_source: HandSource | None = None
    """None where the hand is unknown."""

    def __post_init__(self) -> None:
        name = f"event {quoted(self.native_key)}"
        require_times(name, np.array([self.event_time], dtype=np.float64))
        for place in (self.location, self.box_min, self.box_max):
            if place is not None:
                require_near(name, place[None], farthest=FARTHEST_POSITION)
        if self.published_priming is not None and self.published_priming.prime_time is not None:
            require_times(f"prime of {name}", np.array([self.published_priming.prime_time], dtype=np.float64))


@dataclass(frozen=True)
class Recording:
    """Everything that one recording tells curation; the class that every reader yields, one at a time."""

    dataset: str
    recording_id: str
    participant_id: str
    pose_source: str
    """Source of the body (``adt-optitrack``, ``egoallo``, …); ``none`` without a body."""
    head_tilt_deg: float
    """Rest tilt of that body's neck-head bone, degrees (docs/specification/humanml3d.md#head-forward-vector)."""
    span: tuple[float, float]
    """First and last instant with ground truth, seconds."""
    gaze: GazeStream
    camera: PoseStream
    """The scene camera of the glasses."""
    head: PoseStream
    """The glasses' central pupil frame: x left, y up, z forward."""
    body: BodyStream | None
    hands: tuple[HandStream, ...]
    objects: tuple[ObjectTrack, ...]
    other_people: tuple[OtherPerson, ...] = ()
    annotated_events: tuple[AnnotatedEvent, ...] = ()
    split_group: str = ""
    """Recordings with one group share a split (concurrent twins); the recording's own id where it stands alone."""
    occluders: tuple[Occluder, ...] = ()
    """Meshes of scene and objects, loaded only where a reader is asked for them (option ``meshes``)."""
    hinged_objects: frozenset[str] = frozenset()
    """Ids of doors, drawers and the like, where the dataset says so."""
    world_from_source: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Maps the scene's own coordinates (meshes, point clouds) into this world frame."""
    furniture: tuple[ObjectTrack, ...] = ()
    """Things that stand still and are no part of :attr:`objects`, because the dataset tracks none of them."""
    messages: tuple[str, ...] = ()
    """Messages of the reader for the user."""
    shortfalls: tuple[str, ...] = ()
    """One message for each stream that ends before the recording does; its file may be cut off."""

    def __post_init__(self) -> None:
        start, end = self.span
        object.__setattr__(self, "span", (float(start), float(end)))  # readers take them from arrays
        require_times("ground truth", np.array(self.span, dtype=np.float64))
        _require_distinct("objects", [track.object_id for track in self.objects])
        _require_distinct("events", [f"{event.native_key} ({event.action})" for event in self.annotated_events])

    def hand_streams(self, contact: ContactPoint) -> tuple[HandStream, ...]:
        """The wearer's streams of one kind of contact point."""
        return tuple(stream for stream in self.hands if stream.contact == contact)

    def object(self, object_id: str) -> ObjectTrack:
        """The track of one object.

        Raises:
            KeyError: for an id that the recording does not hold.
        """
        for track in self.objects:
            if track.object_id == object_id:
                return track
        raise KeyError(object_id)
