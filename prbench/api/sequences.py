"""One sequence of a table: its numbers and arrays by name, as a frame, as a picture, as a replay.

Columns and units: docs/table.md; frames: docs/specification/sequence-table.md#encoding.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from prbench.api.arguments import PathLike, as_native_root, as_texts
from prbench.api.frames import frozen
from prbench.api.pictures import Picture, Replay, picture_of, replay_of
from prbench.api.rows import read_row
from prbench.geometry.skeleton import N_JOINTS, Joint, invert_rigid, transform_points
from prbench.sequences import SequenceChunk, SequenceTable

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.replay.scene import Scene

_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False, repr=False)
class Goal:
    """The place of the object at the event: for a pick where it lies, for a put where it will lie."""

    location: Float[np.ndarray, "3"]
    """Centre of the object's box, canonical frame, metres (column ``goal_location``)."""
    box_corners: Float[np.ndarray, "8 3"]
    """The eight corners of the box, canonical frame, metres; the last axis of the world changes fastest."""
    box_world_min: Float[np.ndarray, "3"]
    """Lower end of the box along x, y and z of the world, metres (column ``goal_box_world_min``)."""
    box_world_max: Float[np.ndarray, "3"]
    """Upper end of the box along x, y and z of the world, metres (column ``goal_box_world_max``)."""

    @classmethod
    def of(cls, location: np.ndarray, low: np.ndarray, high: np.ndarray, world_from_canonical: np.ndarray) -> Goal:
        """Return a goal whose corners are computed when they are first asked for."""
        goal = object.__new__(cls)
        goal.__dict__.update(location=location, box_world_min=low, box_world_max=high, _placed=world_from_canonical)
        return goal

    def __getattr__(self, name: str) -> Any:
        """Compute the corners; they are asked for the first time."""
        if name != "box_corners" or "_placed" not in self.__dict__:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        ends = zip(self.box_world_min, self.box_world_max, strict=True)
        corners = np.array(list(itertools.product(*ends)), dtype=np.float64)
        found = frozen(transform_points(invert_rigid(self.__dict__["_placed"]), corners))
        self.__dict__[name] = found  # frozen for everybody else
        return found

    def __repr__(self) -> str:
        x, y, z = self.location
        return f"<Goal at ({x:.3f}, {y:.3f}, {z:.3f}) m>"


@dataclass(frozen=True, eq=False, repr=False)
class Gaze:
    """The direction of the eyes: one ray a frame."""

    origin: Float[np.ndarray, "n 3"]
    """Start of each ray, between the eyes, canonical frame, metres (column ``gaze_origin``)."""
    direction: Float[np.ndarray, "n 3"]
    """Direction of each ray, unit vectors, canonical frame (column ``gaze_direction``)."""
    valid: Bool[np.ndarray, " n"]
    """False where the eye tracker had no measurement; the ray then says nothing (column ``gaze_valid``)."""

    def __repr__(self) -> str:
        return f"<Gaze: {len(self.valid)} rays, {int(self.valid.sum())} of them valid>"


@dataclass(frozen=True, eq=False, repr=False)
class Head:
    """Pose of the glasses that the person wears: x points left, y up and z forward, between the eyes."""

    position: Float[np.ndarray, "n 3"]
    """Position of the glasses in each frame, canonical frame, metres (column ``head_position``)."""
    rotation: Float[np.ndarray, "n 4"]
    """Rotation from the glasses to the canonical frame, unit quaternions w x y z (column ``head_rotation``)."""

    def __repr__(self) -> str:
        return f"<Head: {len(self.position)} positions and rotations>"


@dataclass(frozen=True, eq=False, repr=False)
class Sequence:
    """One prime-and-reach sequence: from 2 s before the first look at the goal until the object is picked or put.

    Positions are in the sequence's own canonical frame unless a name says ``world``: metres, Y up, the pelvis of the
    first frame over the origin facing +Z, the lowest joint of the sequence at Y = 0. All arrays are read-only.
    """

    sequence_id: str
    """Dataset, recording, object, action, native time of the event and pose source, joined by slashes."""
    dataset: str
    """Name of the dataset; it begins with ``synthetic-`` where the people are synthetic."""
    recording_id: str
    """Name of the recording."""
    participant_id: str
    """Name of the person."""
    split: str
    """``train``, ``validation`` or ``test``."""
    action: str
    """``pick`` or ``put``; ``unknown`` only in an imported release."""
    object_id: str
    """The dataset's own id of the object."""
    object_name: str
    """The dataset's name of the object."""
    text: str
    """Sentence that a method conditioned on text is given."""
    hand: str | None
    """The hand that reaches, ``left`` or ``right``; None where nothing decides."""
    fps: float
    """Frames per second."""
    n_frames: int
    """Number of frames; the last one lies exactly on the event."""
    start_time: float
    """Time of the first frame, seconds on the recording's clock."""
    prime_time: float
    """Time of the first look at the goal, seconds on the recording's clock."""
    event_time: float
    """Time of the pick or put, seconds on the recording's clock."""
    prime_kind: str
    """How gaze met the goal: ``hit`` or ``near_miss``; ``published`` or ``unknown`` where it was taken over."""
    prime_time_uncertainty: float
    """Spacing of the gaze samples around the prime time, seconds."""
    body_movement: float
    """Largest distance of the pelvis from its first position, metres."""
    hand_movement: float
    """Largest displacement of the reaching wrist relative to the pelvis, metres."""
    pose_source: str
    """Where the body comes from."""
    head_tilt_deg: float
    """Rest tilt of the neck-head bone of the body's skeleton, degrees; Prime Success needs it."""
    joints: Float[np.ndarray, "n 22 3"]
    """Positions of the 22 joints (:class:`prbench.Joint`) in every frame, canonical frame, metres."""
    previous_joints: Float[np.ndarray, "22 3"]
    """The pose one frame before the first, canonical frame, metres."""
    previous_source: str
    """How the pose before was got: ``recorded``, ``extrapolated`` or ``copied``."""
    next_joints: Float[np.ndarray, "22 3"]
    """The pose one frame after the last, canonical frame, metres."""
    next_source: str
    """How the pose after was got: ``recorded``, ``extrapolated`` or ``copied``."""
    goal: Goal
    """Where the object is at the event."""
    gaze: Gaze
    """Where the eyes look in every frame."""
    head: Head | None
    """Pose of the glasses in every frame; None where it is unknown."""
    world_from_canonical: Float[np.ndarray, "4 4"]
    """Rigid transform from the canonical frame to the recording's world (Y up), metres."""
    extra: Mapping[str, str] = field(default_factory=dict)
    """What only this dataset has, by name."""
    _table: SequenceTable | None = field(default=None, init=False)

    def __getattr__(self, name: str) -> Any:
        """Take a value from the rows that the sequence was read with; it is asked for the first time."""
        source = self.__dict__.get("_source")
        if source is None or name not in _FIELDS:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        rows, row = source
        value = rows.value(name, row)
        self.__dict__[name] = value  # frozen for everybody else
        return value

    def __getstate__(self) -> dict[str, Any]:
        self._take_everything()
        return self.__dict__

    def _take_everything(self) -> None:
        """Take all values, so that the rows that were read together can be forgotten."""
        if "_source" in self.__dict__:
            self.__dict__.update({name: _owned(getattr(self, name)) for name in _FIELDS})
            del self.__dict__["_source"]

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Time of each frame, seconds after the first frame."""
        return np.arange(self.n_frames) / self.fps

    @property
    def prime_after(self) -> float:
        """Time of the first look at the goal, seconds after the first frame; what :func:`prbench.measure` takes."""
        return self.prime_time - self.start_time

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a frame.

        Returns:
            Columns ``frame``, ``time`` (seconds after the first frame), for each joint ``left_wrist_x``,
            ``left_wrist_y``, ``left_wrist_z`` and so on, ``gaze_origin_x`` …, ``gaze_direction_x`` …, ``gaze_valid``
            and, where the glasses are known, ``head_position_x`` … and ``head_rotation_w`` …. Canonical frame, metres.
        """
        import pandas as pd

        columns: dict[str, np.ndarray] = {"frame": np.arange(self.n_frames), "time": self.times}
        for joint in Joint:
            _add(columns, joint.name.lower(), _AXES, self.joints[:, joint])
        _add(columns, "gaze_origin", _AXES, self.gaze.origin)
        _add(columns, "gaze_direction", _AXES, self.gaze.direction)
        columns["gaze_valid"] = self.gaze.valid
        if self.head is not None:
            _add(columns, "head_position", _AXES, self.head.position)
            _add(columns, "head_rotation", ("w", *_AXES), self.head.rotation)
        return pd.DataFrame(columns)

    def plot(self, *, permission: str | Iterable[str] = (), scene: PathLike | None = None) -> Picture:
        """Draw the sequence: poses over time, the way from above, distances of gaze, head and wrists from the goal.

        Args:
            permission: Datasets whose licensor has given you permission to pass recorded motion on; needed only where
                the licence forbids it, because a notebook is easily passed on.
            scene: Your copy of the dataset: draws what stood around the body (needs the extra ``open3d``).

        Returns:
            The picture; a notebook shows it, :meth:`Picture.save` writes it.

        Raises:
            RedistributionError: if the dataset's licence keeps recorded motion and no permission is stated.
        """
        return picture_of((self._scene(permission, scene),))

    def replay(self, *, permission: str | Iterable[str] = (), scene: PathLike | None = None) -> Replay:
        """Show the sequence in 3-D, to turn and play.

        Args:
            permission: See :meth:`plot`.
            scene: See :meth:`plot`.

        Returns:
            The replay; a notebook shows it, :meth:`Replay.save` writes it.

        Raises:
            MissingExtraError: if the extra ``view`` is not installed.
            RedistributionError: if the dataset's licence keeps recorded motion and no permission is stated.
        """
        return replay_of((self._scene(permission, scene),))

    def _scene(self, permission: str | Iterable[str], scene: PathLike | None) -> Scene:
        from prbench.sequences.redistribution import require_may_pass_on
        from prbench.viewing.replay.read import scene_of
        from prbench.workflows.surroundings import Surroundings

        assert self._table is not None, "sequences are made by tables"
        permitted = as_texts(permission)
        info = self._table.info
        require_may_pass_on(info, "the view", permitted)
        around = None if scene is None else Surroundings(info.dataset, as_native_root(scene)).around
        return scene_of(read_row(self._table, self.sequence_id), info, permitted=permitted, around=around)

    def __repr__(self) -> str:
        hand = f", {self.hand} hand" if self.hand else ""
        return (
            f"<Sequence {self.sequence_id}: {self.action} of {self.object_name}{hand},"
            f" {self.n_frames} frames at {self.fps:g} Hz, {self.split}>"
        )

    def _repr_html_(self) -> str:
        from prbench.api.frames import frame_from_rows, notebook_table

        rows = [
            ("sequence_id", self.sequence_id),
            ("recording, split", f"{self.recording_id}, {self.split}"),
            ("text", self.text),
            ("hand", self.hand or "unknown"),
            ("frames", f"{self.n_frames} at {self.fps:g} Hz ({self.n_frames / self.fps:.2f} s)"),
            ("first look at the goal", f"{self.prime_after:.2f} s after the first frame ({self.prime_kind})"),
            ("joints", f"{self.joints.shape}, canonical frame, metres"),
            ("gaze", f"valid in {int(self.gaze.valid.sum())} of {self.n_frames} frames"),
            ("head", "unknown" if self.head is None else "position and rotation in every frame"),
        ]
        frame = frame_from_rows([{"": name, "value": value} for name, value in rows], ["", "value"])
        return notebook_table(f"{self.action} of {self.object_name} ({self.dataset})", frame)


def _add(columns: dict[str, np.ndarray], name: str, axes: Iterable[str], values: np.ndarray) -> None:
    """Add one column for each component of a vector."""
    for number, axis in enumerate(axes):
        columns[f"{name}_{axis}"] = values[:, number]


_PLAIN = (
    "sequence_id", "dataset", "recording_id", "participant_id", "split", "action", "object_id", "object_name", "text",
    "hand", "fps", "n_frames", "start_time", "prime_time", "event_time", "prime_kind", "prime_time_uncertainty",
    "body_movement", "hand_movement", "pose_source", "head_tilt_deg", "previous_source", "next_source",
)  # fmt: skip
"""Columns that hold one plain value a row and have a field of the same name."""
_VECTORS = {"previous_joints": (N_JOINTS, 3), "next_joints": (N_JOINTS, 3), "world_from_canonical": (4, 4)}
"""Columns that hold one array a row, and its shape."""
_FIELDS = frozenset((*_PLAIN, *_VECTORS, "joints", "goal", "gaze", "head", "extra"))


def sequences_of(chunks: Iterable[SequenceChunk], table: SequenceTable) -> Iterator[Sequence]:
    """Yield rows as sequences; none that is kept keeps the chunk that it was read with.

    A sequence takes a value when it is first asked for it, because most callers look at a few of 35, and its arrays are
    views of the chunk. Sequences that are still there when the next chunk has been begun, or when the caller stops,
    take copies of everything.

    Args:
        chunks: Rows with all columns.
        table: The table that they come from.
    """
    given: list[weakref.ref[Sequence]] = []
    before: list[weakref.ref[Sequence]] = []
    try:
        for chunk in chunks:
            # The last sequence of a chunk is the caller's until it has been given the next one.
            before = given
            given = []
            rows = _Rows(chunk)
            for row in range(len(chunk)):
                sequence = object.__new__(Sequence)
                sequence.__dict__["_source"] = (rows, row)
                sequence.__dict__["_table"] = table
                given.append(weakref.ref(sequence))
                yield sequence
                del sequence
                if before:
                    _detach(before)
                    before = []
    finally:
        _detach([*before, *given])


def _detach(references: Iterable[weakref.ref[Sequence]]) -> None:
    """Give the sequences that are still there values of their own."""
    for reference in references:
        kept = reference()
        if kept is not None:
            kept._take_everything()


class _Rows:
    """The fields of a chunk's rows, each made for all rows when it is first asked for."""

    def __init__(self, chunk: SequenceChunk) -> None:
        self._chunk = chunk
        self._made: dict[str, list[Any]] = {}

    def value(self, name: str, row: int) -> Any:
        """Return what a field of :class:`Sequence` holds in one row; arrays are views."""
        made = self._made.get(name)
        if made is None:
            made = self._made[name] = self._make(name)
        return made[row]

    def _make(self, name: str) -> list[Any]:
        if name == "joints":
            return [pose.reshape(-1, N_JOINTS, 3) for pose in self._frames(name)]
        if name == "gaze":
            return list(map(Gaze, *map(self._frames, ("gaze_origin", "gaze_direction", "gaze_valid"))))
        if name == "head":
            return self._heads()
        if name == "goal":
            columns = [
                list(self._vectors(f"goal_{column}")) for column in ("location", "box_world_min", "box_world_max")
            ]
            return list(map(Goal.of, *columns, self._vectors("world_from_canonical", (4, 4))))
        if name in _VECTORS:
            return list(self._vectors(name, _VECTORS[name]))
        values = self._chunk.batch.column(name).to_pylist()
        return [{pair["key"]: pair["value"] for pair in row or ()} for row in values] if name == "extra" else values

    def _frames(self, name: str) -> list[np.ndarray]:
        """Return the frames of each row; rows without a value have none."""
        values = frozen(self._chunk.frames(name))
        lengths = self._chunk.batch.column(name).value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
        return [values[start:stop] for start, stop in itertools.pairwise([0, *np.cumsum(lengths).tolist()])]

    def _vectors(self, name: str, shape: tuple[int, ...] = (3,)) -> Float[np.ndarray, "batch *shape"]:
        return frozen(self._chunk.vectors(name)).reshape(-1, *shape)

    def _heads(self) -> list[Head | None]:
        names = ("head_position", "head_rotation")
        heads = map(Head, *map(self._frames, names))
        known = [self._chunk.batch.column(name).is_valid().to_pylist() for name in names]
        return [head if all(valid) else None for head, *valid in zip(heads, *known, strict=True)]


def _owned(value: Any) -> Any:
    """Return a value that shares no memory with the rows that were read together."""
    if isinstance(value, np.ndarray):
        return frozen(value.copy())
    if isinstance(value, (Goal, Gaze, Head)):
        copied = object.__new__(type(value))
        copied.__dict__.update({name: _owned(part) for name, part in vars(value).items()})
        return copied
    return value
