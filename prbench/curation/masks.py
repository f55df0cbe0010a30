"""Boolean masks over time: runs, and pieces that are debounced and joined into holdings."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

_SLACK = 1e-6  # seconds; times are computed, so equality needs room


def runs(mask: Bool[np.ndarray, " n"]) -> Int[np.ndarray, "k 2"]:
    """First index and end (exclusive) of every run of True, in order."""
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)])


def held_segments(
    held: Bool[np.ndarray, " n"],
    staying: Bool[np.ndarray, " n"],
    times: Float[np.ndarray, " n"],
    *,
    minimum_duration: float,
    join_gap: float,
) -> Int[np.ndarray, "k 2"]:
    """Holdings from raw per-sample evidence (docs/specification/curation.md#in-hand-segmentation).

    Neighbouring runs of ``held`` that are at most ``join_gap`` apart are one piece; pieces shorter than
    ``minimum_duration`` are dropped (debounce); two that are left are joined where every sample between them is
    ``staying`` (hysteresis: it takes more to begin a holding than to go on with one).

    Args:
        held: Samples at which the object is surely held: a hand is close and the object moves.
        staying: Samples that do not end a holding: the hand stays close.
        times: Strictly increasing, seconds.
        minimum_duration: Shortest piece that counts, seconds.
        join_gap: Longest interruption that is bridged whatever happens in it, seconds.

    Returns:
        First index and end (exclusive) of each holding, in order, without overlap.
    """
    pieces = runs(held)
    pieces = _joined(pieces, times[pieces[1:, 0]] - times[pieces[:-1, 1] - 1] <= join_gap + _SLACK)
    pieces = pieces[times[pieces[:, 1] - 1] - times[pieces[:, 0]] >= minimum_duration - _SLACK]
    left_before = np.concatenate(([0], np.cumsum(~staying)))
    return _joined(pieces, left_before[pieces[1:, 0]] == left_before[pieces[:-1, 1]])


def _joined(pieces: Int[np.ndarray, "k 2"], together: Bool[np.ndarray, " gaps"]) -> Int[np.ndarray, "m 2"]:
    """Pieces with the gaps between them closed where ``together`` says so; one entry a gap."""
    if len(pieces) == 0:
        return pieces
    return np.column_stack(
        [pieces[np.concatenate(([True], ~together)), 0], pieces[np.concatenate((~together, [True])), 1]]
    )
