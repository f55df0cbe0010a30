"""Features of a whole table, computed once and memory-mapped from then on.

One Arrow IPC file per table, split and way of encoding lies in prbench's cache folder. It opens in milliseconds, every
process that reads it shares its pages, and an item is a view of it. Files may be deleted at any time: what is missing
is made again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.ipc
from jaxtyping import Float, Int

from prbench.geometry.skeleton import N_JOINTS
from prbench.representation import N_FEATURES
from prbench_adapters.training.motions import Motion

_POSE = pa.list_(pa.float32(), 3 * N_JOINTS)

STORE = pa.schema(
    [
        pa.field("sequence_id", pa.string(), nullable=False),
        pa.field("texts", pa.list_(pa.string()), nullable=False),
        pa.field("n_frames", pa.int32(), nullable=False),
        pa.field("joints", pa.list_(_POSE), nullable=False),
        pa.field("previous_joints", _POSE, nullable=False),
        pa.field("next_joints", _POSE, nullable=False),
        pa.field("goal_location", pa.list_(pa.float32(), 3), nullable=False),
        pa.field("features", pa.list_(pa.list_(pa.float32(), N_FEATURES)), nullable=False),
    ]
)
"""One row a motion. One that is longer than an item may be has no features, because each of its crops has its own."""


class FeatureStore:
    """A store on disk, opened; it travels to other processes as a path and is opened there again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._open()

    def __len__(self) -> int:
        return len(self.n_frames)

    def sequence_id(self, row: int) -> str:
        """The id of a row; that of a mirrored copy ends with ``#mirrored``."""
        block, place = self._at(row)
        return block.batch.column("sequence_id")[place].as_py()

    def texts(self, row: int) -> tuple[str, ...]:
        """All captions of a row."""
        block, place = self._at(row)
        return tuple(block.batch.column("texts")[place].as_py())

    def motion(self, row: int) -> Motion:
        """The whole motion of a row: views of the file, not to be written to."""
        block, place = self._at(row)
        return Motion(
            joints=block.joints[block.joint_offsets[place] : block.joint_offsets[place + 1]],
            previous_joints=block.previous_joints[place],
            next_joints=block.next_joints[place],
            goal_location=block.goal_location[place],
        )

    def features(self, row: int) -> Float[np.ndarray, "n 263"] | None:
        """Features of a row, a view of the file; None for a motion that has to be cut first."""
        block, place = self._at(row)
        start, stop = block.feature_offsets[place : place + 2]
        return block.features[start:stop] if stop > start else None

    def _open(self) -> None:
        with pa.memory_map(str(self.path)) as source:  # the batches keep the mapping alive
            reader = pa.ipc.open_file(source)
            self._blocks = [_Block.of(reader.get_batch(i)) for i in range(reader.num_record_batches)]
        counts = [block.batch.num_rows for block in self._blocks]
        self._starts = np.concatenate(([0], np.cumsum(counts)))
        # An empty store has no blocks, and concatenate needs at least one array.
        lengths = [block.batch.column("n_frames").to_numpy() for block in self._blocks]
        self.n_frames: Int[np.ndarray, " rows"] = np.concatenate([np.empty(0, np.int32), *lengths]).astype(np.int64)

    def _at(self, row: int) -> tuple[_Block, int]:
        if not 0 <= row < len(self):
            raise IndexError(f"row {row} of {len(self)}")
        index = int(np.searchsorted(self._starts, row, side="right")) - 1
        return self._blocks[index], int(row - self._starts[index])

    def __getstate__(self) -> dict[str, Path]:
        return {"path": self.path}

    def __setstate__(self, state: dict[str, Path]) -> None:
        self.path = state["path"]
        self._open()


@dataclass(frozen=True)
class _Block:
    """The arrays of one record batch: views of the mapped file."""

    batch: pa.RecordBatch
    joints: np.ndarray
    joint_offsets: np.ndarray
    features: np.ndarray
    feature_offsets: np.ndarray
    previous_joints: np.ndarray
    next_joints: np.ndarray
    goal_location: np.ndarray

    @classmethod
    def of(cls, batch: pa.RecordBatch) -> _Block:
        joints = batch.column("joints")
        features = batch.column("features")
        return cls(
            batch,
            _values(joints.values).reshape(-1, N_JOINTS, 3),
            joints.offsets.to_numpy(),
            _values(features.values),
            features.offsets.to_numpy(),
            _values(batch.column("previous_joints")).reshape(-1, N_JOINTS, 3),
            _values(batch.column("next_joints")).reshape(-1, N_JOINTS, 3),
            _values(batch.column("goal_location")),
        )


def _values(vectors: pa.FixedSizeListArray) -> np.ndarray:
    return vectors.values.to_numpy(zero_copy_only=True).reshape(-1, vectors.type.list_size)
