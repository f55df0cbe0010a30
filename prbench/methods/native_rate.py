"""Methods that generate at their own frame rate: conditions to that rate, motions back to the table's grid."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Int

from prbench.contract import ConditionBatch, Motions


def native_frames(n_frames: Int[np.ndarray, " n"], *, fps: float, native_fps: float) -> Int[np.ndarray, " n"]:
    """Count the frames at the native rate that cover ``n_frames`` at the table's: the last one at or after the end."""
    return np.ceil((n_frames - 1) * (native_fps / fps) - 1e-9).astype(np.int64) + 1


def at_native_rate(batch: ConditionBatch, native_fps: float) -> ConditionBatch:
    """Return the batch as the method is to see it.

    The frame before the first lies one native frame before it: its offset, a velocity, is scaled with the rate.
    """
    changed: dict[str, object] = {
        "fps": native_fps,
        "n_frames": native_frames(batch.n_frames, fps=batch.fps, native_fps=native_fps),
    }
    if batch.initial_joints is not None and batch.previous_joints is not None:
        step = (batch.previous_joints - batch.initial_joints) * (batch.fps / native_fps)
        changed["previous_joints"] = (batch.initial_joints + step).astype(batch.previous_joints.dtype)
    return dataclasses.replace(batch, **changed)


def at_table_rate(motions: Motions, batch: ConditionBatch, *, native_fps: float) -> Motions:
    """Interpolate native motions linearly at the times of the table's frames.

    Args:
        motions: At ``native_fps``, of the lengths of :func:`native_frames`.
        batch: At the table's rate.
        native_fps: Frames per second of ``motions``.
    """
    place = np.arange(int(batch.n_frames.max())) * (native_fps / batch.fps)  # in native frames
    last = motions.n_frames[:, None] - 1
    left = np.minimum(np.floor(place + 1e-9).astype(np.int64), last)  # (batch, frames)
    right = np.minimum(left + 1, last)
    weight = np.clip(place - left, 0.0, 1.0)[..., None, None]
    row = np.arange(len(batch))[:, None]
    joints = motions.joints[row, left] * (1 - weight) + motions.joints[row, right] * weight
    return Motions(joints.astype(np.float32), batch.n_frames, motions.cost)
