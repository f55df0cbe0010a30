"""Rows that know the future: what happened itself, and what a few coefficients of its transform can show of it.

Source: docs/specification/motion-prediction.md#references. They are no predictors: nothing that a predictor is given
leads to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float, Int
from scipy.fft import dct, idct

from prbench.errors import UsageError
from prbench_benchmarks.motion_prediction.batch import Condition, Futures, ObservedBatch
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.scoring import Scores, SimilarPasts, add_scores
from prbench_benchmarks.motion_prediction.table import Truth, WindowsTable

GROUND_TRUTH = "ground-truth"
TRUNCATION_FLOOR = "truncation-floor"
Reference = Callable[[ObservedBatch, Truth], Futures]


def ground_truth(batch: ObservedBatch, truth: Truth) -> Futures:
    """What happened, as the only sample; the last pose is held after an event."""
    return Futures(joints=_whole_futures(batch, truth)[:, None])


def truncation_floor(coefficients: int) -> Reference:
    """What is left of the true windows when only their first coefficients are kept.

    A network that describes a window by L coefficients cannot be better than this, whatever it learns.

    Args:
        coefficients: L of the orthonormal DCT-II over observed and future frames.

    Raises:
        UsageError: for less than one.
    """
    if coefficients < 1:
        raise UsageError(f"truncation floor: expected one coefficient or more, found {coefficients}.")

    def truncated(batch: ObservedBatch, truth: Truth) -> Futures:
        windows = np.concatenate([batch.observed_joints, _whole_futures(batch, truth)], axis=1).astype(np.float64)
        kept = np.asarray(dct(windows, axis=1, norm="ortho"))
        kept[:, coefficients:] = 0.0
        future = np.asarray(idct(kept, axis=1, norm="ortho"))[:, batch.observed_joints.shape[1] :]
        return Futures(joints=future[:, None].astype(np.float32))

    return truncated


def _whole_futures(batch: ObservedBatch, truth: Truth) -> Float[np.ndarray, "batch future joints 3"]:
    """The recorded frames; where a window ends with its event, the last pose is held as nobody knows what follows."""
    frame = np.minimum(np.arange(batch.n_future), truth.n_scored[:, None] - 1)
    return truth.joints[np.arange(len(batch))[:, None], frame]


def score_reference(
    reference: Reference,
    table: WindowsTable,
    chosen: Int[np.ndarray, " n"],
    *,
    similar: SimilarPasts | None = None,
    size: int = 64,
) -> Scores:
    """Score a reference as a predictor is scored.

    Args:
        reference: :func:`ground_truth`, or what :func:`truncation_floor` returned.
        table: The windows.
        chosen: Places of windows.
        similar: For MMADE and MMFDE; these are left out without it.
        size: Windows of a batch.
    """
    rules = load_prediction_protocol().evaluation
    scores = Scores()
    for batch, truth in table.batches(Condition.POSE, chosen, frame="room", size=size):
        add_scores(scores, batch, reference(batch, truth), truth, table.joints, rules, similar=similar)
    return scores


def references() -> Mapping[str, Reference]:
    """The references by name, the floor with the protocol's number of coefficients."""
    coefficients = load_prediction_protocol().evaluation.coefficients
    return {TRUNCATION_FLOOR: truncation_floor(coefficients), GROUND_TRUTH: ground_truth}
