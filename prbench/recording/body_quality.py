"""Which body frames can be believed (``formats/adt.md`` section 4)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from prbench.skeleton import bone_lengths
from prbench.timelines import nearest_index

_BONE_TOLERANCE = 0.20  # share of the recording's median bone length
_FASTEST_JOINT = 10.0  # m/s


def plausible_body_frames(
    times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"]
) -> Bool[np.ndarray, " n"]:
    """Frames that are finite, not all at the origin, keep their bone lengths, and do not jump.

    A frame is implausible when it holds a NaN, when all joints are (0, 0, 0), when a bone differs from the recording's
    median length by more than 20 %, or when a joint moves faster than 10 m/s *both* from the last plausible-looking
    neighbour and towards the next one, so that the good frames around a single jump stay valid.

    Args:
        times: Strictly increasing, seconds.
        joints: World frame, metres; may hold NaN.
    """
    finite = np.isfinite(joints).all(axis=(1, 2))
    shaped = finite & ~(np.nan_to_num(joints) == 0).all(axis=(1, 2))
    if not shaped.any():
        return shaped
    lengths = bone_lengths(joints[shaped])
    median = np.median(lengths, axis=0)
    shaped[shaped] = (np.abs(lengths - median) <= _BONE_TOLERANCE * median).all(axis=1)
    index = np.flatnonzero(shaped)
    if len(index) < 3:
        return shaped
    step = np.linalg.norm(np.diff(joints[index], axis=0), axis=-1).max(axis=1) / np.diff(times[index])
    fast = step > _FASTEST_JOINT
    isolated = np.concatenate(([fast[0]], fast[:-1] & fast[1:], [fast[-1]]))
    # At either end only one neighbour exists; blame the end frame only if its neighbour is calm on its other side.
    isolated[0] &= not fast[1]
    isolated[-1] &= not fast[-2]
    shaped[index[isolated]] = False
    return shaped


def hold_neighbours(
    values: Float[np.ndarray, "n *shape"], valid: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n *shape"]:
    """Invalid rows replaced by the nearest valid one (of two equally near the earlier); zeros if none is valid."""
    index = np.flatnonzero(valid)
    if len(index) == 0:
        return np.zeros_like(values)
    if len(index) == len(values):
        return values
    return values[index[nearest_index(index.astype(np.float64), np.arange(len(values), dtype=np.float64))]]
