"""What a direction of the head, and what gaze is worth to a predictor: paired differences between conditions.

Source: docs/specification/motion-prediction.md#the-value-of-gaze. Windows are paired; intervals are over recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from prbench.evaluation.comparisons import holm
from prbench.evaluation.prediction_summary import Difference, differences
from prbench.prediction.batch import Condition
from prbench.prediction.scoring import Scores

EVERY = "all"
"""Stands for the windows of all anchors."""
VALUE_METRICS = ("ade", "fde", "ade_mean", "wrist_to_goal", "wrist_to_goal_mean", "pelvis_at_event")
"""Metrics for which the value is told, metres, less is better; those at the goal exist in anchored windows alone."""


@dataclass(frozen=True)
class ValueOfCondition:
    """How much less one metric becomes where a predictor is told more."""

    method: str
    anchor: str
    """``all``, or the anchor of the windows, such as ``event-1.5``."""
    metric: str
    less: Condition
    more: Condition
    difference: Difference
    """With ``more`` minus with ``less``, metres: below zero where the further knowledge helps."""
    adjusted_p_value: float | None
    """After Holm's correction for all methods and pairs of conditions of one metric and anchor."""


def values_of_conditions(scores: Mapping[str, Mapping[Condition, Scores]]) -> tuple[ValueOfCondition, ...]:
    """Compare every pair of conditions of each method, over all windows and for each anchor.

    Args:
        scores: Scores of the same windows by method and condition.

    Raises:
        UsageError: if the scores of a method are of different windows.
    """
    found = [
        (method, anchor, metric, less, more, difference)
        for method, by_condition in scores.items()
        for less, more in itertools.combinations([each for each in Condition if each in by_condition], 2)
        for anchor in _anchors(by_condition[less])
        for metric, difference in _compared(by_condition[less], by_condition[more], anchor).items()
    ]
    adjusted: dict[int, float | None] = {}
    for family in dict.fromkeys((anchor, metric) for _, anchor, metric, *_ in found):
        places = [place for place, (_, anchor, metric, *_) in enumerate(found) if (anchor, metric) == family]
        adjusted |= dict(zip(places, holm([found[place][5].p_value for place in places]), strict=True))
    return tuple(ValueOfCondition(*each, adjusted[place]) for place, each in enumerate(found))


def lead_of(anchor: str) -> float | None:
    """Seconds before the event of an anchor such as ``event-1.5``; None for any other."""
    name, _, seconds = anchor.partition("-")
    return float(seconds) if name == "event" and seconds else None


def _anchors(scores: Scores) -> Iterable[str]:
    """All windows together, and each anchor where there are several."""
    anchors = sorted(set(scores.columns["anchor"]))
    return [EVERY, *anchors] if len(anchors) > 1 else [EVERY]


def _compared(less: Scores, more: Scores, anchor: str) -> dict[str, Difference]:
    if anchor != EVERY:
        less = less.only(np.array(less.columns["anchor"]) == anchor)
        more = more.only(np.array(more.columns["anchor"]) == anchor)
    return {name: each for name, each in differences(less, more).items() if name in VALUE_METRICS}
