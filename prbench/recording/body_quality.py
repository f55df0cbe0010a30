"""Find the plausible body frames (docs/specification/adt.md#joints)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import bone_lengths
from prbench.geometry.timelines import nearest_index

_BONE_TOLERANCE = 0.20  # share of the recording's median bone length
_FASTEST_JOINT = 10.0  # m/s
_LONGEST_EXCURSION = 0.1  # seconds; what may be interpolated


def plausible_body_frames(
    times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"]
) -> Bool[np.ndarray, " n"]:
    """Frames that are finite, not all at the origin, keep their bone lengths, and do not jump.

    A frame is implausible when it holds a NaN, when all joints are (0, 0, 0), when a bone differs from the recording's
    median length by more than 20 %, or when it belongs to an excursion: at most 0.1 s between two steps in which
    a joint moves faster than 10 m/s (or between one and an end of the recording). The good frames around it stay valid.

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
    shaped[index[_excursions(times[index], step > _FASTEST_JOINT)]] = False
    return shaped


def _excursions(times: Float[np.ndarray, " n"], fast: Bool[np.ndarray, " steps"]) -> Bool[np.ndarray, " n"]:
    """Frames of every short run between fast steps; the longest run is never one."""
    run = np.concatenate(([0], np.cumsum(fast)))
    first = np.flatnonzero(np.diff(run, prepend=-1))
    last = np.append(first[1:], len(run)) - 1
    duration = times[last] - times[first]
    short = duration <= _LONGEST_EXCURSION
    # In a very short recording the longest run is the body itself.
    short[np.argmax(duration)] = False
    return short[run]


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
