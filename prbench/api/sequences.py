"""One sequence of a table: its numbers and arrays by name, as a frame, as a picture, as a replay.

Columns and units: docs/table.md; frames: docs/specification/sequence-table.md#encoding.
"""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from prbench import sequences
from prbench.api.arguments import PathLike, as_native_root, as_texts
from prbench.api.frames import frame_from_rows, frozen, notebook_table
from prbench.api.pictures import Picture, Replay, picture_of, replay_of
from prbench.geometry.skeleton import Joint, invert_rigid, transform_points
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.sequences.chunk import row_values
from prbench.sequences.sequence import SEQUENCES

if TYPE_CHECKING:
    import pandas as pd

    from prbench.viewing.replay.scene import Scene

_COLUMNS = dict.fromkeys(SEQUENCES.names)
"""Names of the columns, in their order; a dictionary finds one at once."""


@dataclass(frozen=True, eq=False, repr=False)
class Goal:
    """The place of the object at the event: for a pick where it lies, for a put where it will lie."""

    location: Float[np.ndarray, "3"]
    """Centre of the object's box, canonical frame, metres (column ``goal_location``)."""
    box_world_min: Float[np.ndarray, "3"]
    """Lower end of the box along x, y and z of the world, metres (column ``goal_box_world_min``)."""
    box_world_max: Float[np.ndarray, "3"]
    """Upper end of the box along x, y and z of the world, metres (column ``goal_box_world_max``)."""
    _world_from_canonical: Float[np.ndarray, "4 4"]

    @cached_property
    def box_corners(self) -> Float[np.ndarray, "8 3"]:
        """The eight corners of the box, canonical frame, metres; the last axis of the world changes fastest."""
        ends = zip(self.box_world_min, self.box_world_max, strict=True)
        corners = np.array(list(itertools.product(*ends)), dtype=np.float64)
        return frozen(transform_points(invert_rigid(self._world_from_canonical), corners))

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
class Sequence(sequences.Sequence):
    """One prime-and-reach sequence: from 2 s before the first look at the goal until the object is picked or put.

    Every column of the table (docs/table.md#sequences) is an attribute of that name, read when it is first asked for;
    ``goal``, ``gaze`` and ``head`` hold the columns that belong together. Positions are in the sequence's own canonical
    frame unless a name says ``world``: metres, Y up, the pelvis of the first frame over the origin facing +Z, the
    lowest joint of the sequence at Y = 0. All arrays are read-only.
    """

    _table: SequenceTable | None = field(default=None, init=False)

    def __getattr__(self, name: str) -> Any:
        """Take a value from the rows that the sequence was read with; it is asked for the first time."""
        source = self.__dict__.get("_source")
        if source is None or name not in _COLUMNS:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        columns, row = source
        value = columns[name][row]
        self.__dict__[name] = value  # frozen for everybody else
        return value

    def __getstate__(self) -> dict[str, Any]:
        self._take_everything()
        return self.__dict__

    def _take_everything(self) -> None:
        """Take copies of all values, so that the rows that were read together can be forgotten."""
        if "_source" not in self.__dict__:
            return
        values = {name: getattr(self, name) for name in _COLUMNS}
        own = {name: frozen(each.copy()) if isinstance(each, np.ndarray) else each for name, each in values.items()}
        for made_of_views in ("_source", "goal", "gaze", "head"):
            self.__dict__.pop(made_of_views, None)
        self.__dict__.update(own)

    @cached_property
    def goal(self) -> Goal:
        """Where the object is at the event."""
        box = self.goal_box_world_min, self.goal_box_world_max
        return Goal(self.goal_location, *box, self.world_from_canonical)

    @cached_property
    def gaze(self) -> Gaze:
        """Where the eyes look in every frame."""
        return Gaze(self.gaze_origin, self.gaze_direction, self.gaze_valid)

    @cached_property
    def head(self) -> Head | None:
        """Pose of the glasses in every frame; None where it is unknown."""
        if self.head_position is None or self.head_rotation is None:
            return None
        return Head(self.head_position, self.head_rotation)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a frame.

        Returns:
            Columns ``frame``, ``time`` (seconds after the first frame), for each joint ``left_wrist_x``,
            ``left_wrist_y``, ``left_wrist_z`` and so on, ``gaze_origin_x`` …, ``gaze_direction_x`` …, ``gaze_valid``
            and, where the glasses are known, ``head_position_x`` … and ``head_rotation_w`` …. Canonical frame, metres.
        """
        import pandas as pd

        columns: dict[str, np.ndarray] = {"frame": np.arange(self.n_frames), "time": self.times}

        def add(name: str, values: np.ndarray, axes: str = "xyz") -> None:
            columns.update({f"{name}_{axis}": values[:, number] for number, axis in enumerate(axes)})

        for joint in Joint:
            add(joint.name.lower(), self.joints[:, joint])
        add("gaze_origin", self.gaze_origin)
        add("gaze_direction", self.gaze_direction)
        columns["gaze_valid"] = self.gaze_valid
        if self.head is not None:
            add("head_position", self.head.position)
            add("head_rotation", self.head.rotation, axes="wxyz")
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
        from prbench.viewing.surroundings import Surroundings

        assert self._table is not None, "sequences are made by tables"
        permitted = as_texts(permission)
        info = self._table.info
        require_may_pass_on(info, "the view", permitted)
        around = None if scene is None else Surroundings(info.dataset, as_native_root(scene)).around
        return scene_of(self._table.row(self.sequence_id), info, permitted=permitted, around=around)

    def _repr_html_(self) -> str:
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
        frame = frame_from_rows(rows, ["", "value"])
        return notebook_table(f"{self.action} of {self.object_name} ({self.dataset})", frame)


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
            columns = _Columns(chunk.batch)
            for row in range(len(chunk)):
                sequence = object.__new__(Sequence)
                sequence.__dict__["_source"] = (columns, row)
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


class _Columns(dict[str, list[Any]]):
    """The values of a chunk's columns by name, each made for all rows when it is first asked for."""

    def __init__(self, batch: pa.RecordBatch) -> None:
        super().__init__()
        self._batch = batch

    def __missing__(self, name: str) -> list[Any]:
        self[name] = row_values(self._batch.column(name))
        return self[name]
