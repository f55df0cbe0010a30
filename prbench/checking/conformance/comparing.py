"""Distances between answers, and how to say them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance.answer import Answer

TOLERANCE = 1e-4
"""Metres by which a motion may change where only rounding differs (docs/specification/protocol.md#reproducibility)."""


def largest_changes(first: Answer, second: Answer, rows: list[int] | None = None) -> Float[np.ndarray, " rows"]:
    """Of each motion the largest distance of any joint in any frame between two answers, metres.

    Args:
        first: Any answer with motions.
        second: Answers rows of the same lengths.
        rows: Where in ``first`` each row of ``second`` stands; None for the same order.
    """
    places = range(len(second.batch)) if rows is None else rows
    return np.array(
        [
            float(np.linalg.norm(first.motion(place) - second.motion(row), axis=-1).max())
            for row, place in enumerate(places)
        ]
    )


def same_bytes(first: Answer, second: Answer) -> bool:
    """Whether two answers to the same batch hold the same numbers to the last bit."""
    return all(np.array_equal(first.motion(row), second.motion(row)) for row in range(len(first.batch)))


def metres(distance: float) -> str:
    """A distance in the unit in which it is easily read.

    >>> metres(0.034)
    '3.4 cm'
    """
    if distance >= 1:
        return f"{distance:.2f} m"
    if distance >= 0.001:
        return f"{distance * 100:.1f} cm"
    return f"{distance:.1e} m" if distance else "0 m"
