"""Motions of another length than the recorded ones: said with the cause that the numbers suggest."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Int

_USUAL_RATES = (10.0, 12.5, 15.0, 20.0, 24.0, 25.0, 30.0, 50.0, 60.0, 90.0, 100.0, 120.0)
_FEWEST_FOR_RATE = 2  # one motion of another length says nothing about a rate


def length_problem(
    place: Callable[[int], str], expected: Int[np.ndarray, " n"], found: Int[np.ndarray, " n"], *, fps: float
) -> str | None:
    """Say what is wrong with the lengths of some motions; None if they are right.

    Args:
        place: Where a motion stands, and its name, by its row.
        expected: Frames that each should have.
        found: Frames that each has.
        fps: Rate of ``expected``.

    Returns:
        The first motion of another length, how many more there are, and the likely cause.
    """
    wrong = np.flatnonzero(found != expected)
    if not wrong.size:
        return None
    row = int(wrong[0])
    more = f" (and {wrong.size - 1} other motions of {len(expected)})" if wrong.size > 1 else ""
    cause = likely_cause(expected, found, fps=fps)
    return f"{place(row)}: expected {expected[row]} frames, found {found[row]}{more}.{' ' if cause else ''}{cause}"


def likely_cause(expected: Int[np.ndarray, " n"], found: Int[np.ndarray, " n"], *, fps: float) -> str:
    """A sentence that explains all the lengths that are wrong, or nothing."""
    wrong = found != expected
    off = (found - expected)[wrong]
    # Off by one comes first: such lengths also fit a frame rate within the rounding of a frame.
    if (off == 1).all():
        return (
            "There is one frame too many: the frame before the first (previous_joints) is no part of the motion, and"
            " the last frame is the one of the goal."
        )
    if (off == -1).all():
        return (
            "There is one frame too few: the first frame is the given initial one, and features of differences have a"
            " row less than there are frames."
        )
    rate = _rate(expected, found, fps=fps)
    if rate is not None:
        return (
            f"They look like motions at {rate:g} frames per second where {fps:g} are asked for: resample them, or"
            f" export the conditions with --native-fps {rate:g} and generate anew."
        )
    longest = int(found.max())
    if wrong.sum() > 1 and (found == np.minimum(expected, longest)).all():
        return (
            f"None has more than {longest} frames: if the method can make no more, export the conditions with"
            f" --max-frames {longest}, so that longer sequences count as unsupported."
        )
    if wrong.sum() > 1 and (found == longest).all():
        return f"All have {longest} frames, as padded motions do: cut each to the n_frames of its condition."
    return ""


def _rate(expected: np.ndarray, found: np.ndarray, *, fps: float) -> float | None:
    """The usual frame rate at which all motions would have these lengths, up to a frame."""
    if len(expected) < _FEWEST_FOR_RATE:
        return None
    for rate in _USUAL_RATES:
        if rate != fps and (np.abs(found - ((expected - 1) * rate / fps + 1)) <= 1).all():
            return rate
    return None
