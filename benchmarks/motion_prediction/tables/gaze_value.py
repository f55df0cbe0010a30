"""What a direction of the head, and what gaze is worth to a predictor: paired differences between conditions.

Source: docs/specification/motion-prediction.md#the-value-of-gaze. Windows are paired; intervals are over recordings.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from prbench.harness.intervals import Comparison, PairedValues, compare
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.scoring import Scores
from prbench_benchmarks.motion_prediction.tables.estimates import paired

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
    comparison: Comparison
    """With ``more`` minus with ``less``, metres: below zero where the further knowledge helps. Corrected for all
    methods and pairs of conditions of one metric and anchor."""


def values_of_conditions(scores: Mapping[str, Mapping[Condition, Scores]]) -> tuple[ValueOfCondition, ...]:
    """Compare every pair of conditions of each method, over all windows and for each anchor.

    Args:
        scores: Scores of the same windows by method and condition.

    Raises:
        UsageError: if the scores of a method are of different windows.
    """
    pairs = {
        (method, anchor, metric, less, more): values
        for method, by_condition in scores.items()
        for less, more in itertools.combinations([each for each in Condition if each in by_condition], 2)
        for anchor in _anchors(by_condition[less])
        for metric, values in _paired(by_condition[less], by_condition[more], anchor).items()
    }
    found: dict[tuple, Comparison] = {}
    for family in dict.fromkeys((anchor, metric) for _, anchor, metric, *_ in pairs):
        keys = {str(place): key for place, key in enumerate(pairs) if key[1:3] == family}
        compared = compare({name: pairs[key] for name, key in keys.items()})
        found |= {key: compared[name] for name, key in keys.items()}
    return tuple(ValueOfCondition(*key, found[key]) for key in pairs)


def lead_of(anchor: str) -> float | None:
    """Seconds before the event of an anchor such as ``event-1.5``; None for any other."""
    name, _, seconds = anchor.partition("-")
    return float(seconds) if name == "event" and seconds else None


def _anchors(scores: Scores) -> Iterable[str]:
    """All windows together, and each anchor where there are several."""
    anchors = sorted(set(scores.columns["anchor"]))
    return [EVERY, *anchors] if len(anchors) > 1 else [EVERY]


def _paired(less: Scores, more: Scores, anchor: str) -> dict[str, PairedValues]:
    if anchor != EVERY:
        less = less.only(np.array(less.columns["anchor"]) == anchor)
        more = more.only(np.array(more.columns["anchor"]) == anchor)
    return {name: values for name, values in paired(more, less).items() if name in VALUE_METRICS}
