"""A method whose motions depend on everything that it is given, and on nothing else."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.harness.offline import ConditionsFile

SOURCE = """
    from tests.harness.offline.method import Drift

    def load(weights, *, options, device):
        return Drift(**{name: float(value) for name, value in options.items()})
"""


class Drift:
    """Moves the initial pose along a random line towards the goal; float64, so that rounding has its say."""

    name = "drift"
    conditions = frozenset(Condition)

    def __init__(self, *, native_fps: float | None = None, max_frames: float | None = None) -> None:
        self.native_fps = native_fps
        self.max_frames = None if max_frames is None else int(max_frames)

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        joints = np.full((len(batch), int(batch.n_frames.max()), 22, 3), np.nan)
        for row in range(len(batch)):
            n = int(batch.n_frames[row])
            joints[row, :n] = self._motion(batch.rows(row, row + 1), n)
        return Motions(joints, batch.n_frames)

    @staticmethod
    def _motion(one: ConditionBatch, n: int) -> np.ndarray:
        digest = hashlib.sha256(f"{one.opaque_id[0]} {one.text}".encode()).digest()
        start = np.zeros((22, 3)) if one.initial_joints is None else one.initial_joints[0].astype(np.float64)
        end = start + digest[0] / 300
        if one.goal_joints is not None:
            end = end + one.goal_joints[0]
        if one.goal_location is not None:
            end = end + one.goal_location[0]
        if one.previous_joints is not None:
            end = end + (start - one.previous_joints[0]) * one.fps
        noise = np.random.default_rng(one.noise_seed[0]).normal(size=(n, 22, 3)) * 0.02
        return start + np.linspace(0, 1, n)[:, None, None] * (end - start) + noise


def generated(conditions: ConditionsFile, *, batch_size: int = 7) -> list[np.ndarray]:
    """What the method makes of a file, in other batches and another order than a run has."""
    motions: list[np.ndarray] = [np.empty(0)] * len(conditions)
    for rows, batch in reversed(list(batches_of(conditions, batch_size))):
        made = Drift().generate(batch, seed=0)
        for i, row in enumerate(rows):
            motions[row] = made.joints[i, : made.n_frames[i]]
    return motions


def batches_of(conditions: ConditionsFile, batch_size: int = 64) -> Iterator[tuple[np.ndarray, ConditionBatch]]:
    """Rows of one sample and one frame rate, and the batch that a method gets of them."""
    for sample in np.unique(conditions.sample):
        for fps in np.unique(conditions.fps):
            rows = np.flatnonzero((conditions.sample == sample) & (conditions.fps == fps))
            for start in range(0, len(rows), batch_size):
                part = conditions.rows(rows[start : start + batch_size])
                batch = ConditionBatch(
                    condition=conditions.info.condition,
                    n_frames=part.n_frames.astype(np.int64),
                    fps=float(fps),
                    opaque_id=part.opaque_id,
                    noise_seed=tuple(part.noise_seed.tolist()),
                    **{name: getattr(part, name) for name in conditions.given},
                )
                yield rows[start : start + batch_size], batch


def write_parquet(path: Path, conditions: ConditionsFile, motions: list[np.ndarray], *, flat: bool) -> Path:
    """Nested frames, or all numbers of a motion after one another; the last row first."""
    shown = [motion.reshape(-1 if flat else len(motion), *([] if flat else [66])).tolist() for motion in motions]
    kind = pa.list_(pa.float64()) if flat else pa.list_(pa.list_(pa.float32(), 66))
    columns = {
        "opaque_id": conditions.opaque_id[::-1],
        "sample": conditions.sample[::-1],
        "joints": pa.array(shown[::-1], kind),
    }
    pq.write_table(pa.table(columns), path, row_group_size=11)
    return path


def write_padded(path: Path, conditions: ConditionsFile, motions: list[np.ndarray]) -> Path:
    """One array of all motions, as wide as the longest."""
    joints = np.full((len(motions), max(map(len, motions)), 22, 3), np.nan)
    for row, motion in enumerate(motions):
        joints[row, : len(motion)] = motion
    np.savez(path, joints=joints, **_beside(conditions))
    return path


def write_ragged(path: Path, conditions: ConditionsFile, motions: list[np.ndarray]) -> Path:
    """All frames after one another, compressed."""
    np.savez_compressed(path, joints=np.concatenate(motions).astype(np.float32), **_beside(conditions))
    return path


def write_named(path: Path, conditions: ConditionsFile, motions: list[np.ndarray]) -> Path:
    """One array a sequence, its samples in it."""
    arrays: dict[str, list[np.ndarray]] = {}
    for name, motion in zip(conditions.opaque_id, motions):
        arrays.setdefault(name, []).append(motion)
    np.savez(path, **{name: np.stack(drawn) for name, drawn in arrays.items()})
    return path


def _beside(conditions: ConditionsFile) -> dict[str, np.ndarray]:
    return {"opaque_id": np.array(conditions.opaque_id), "sample": conditions.sample, "n_frames": conditions.n_frames}
