"""What the data of a table can decide, and what not.

Source: docs/specification/protocol.md#comparisons.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from statistics import median

from prbench.harness.clusters import FEWEST_FOR_TEST, recordings_needed
from prbench.harness.comparisons import POINTS, POWER
from prbench.harness.run_folder.summary import MetricSummary
from prbench.metrics import RANKED_METRICS, MetricInfo, printed_unit

FEWEST_RANKED = 50
"""Sequences below which no method is ranked."""


def undecided(
    dataset: str,
    sequences: int,
    recordings: int,
    methods: Sequence[Iterable[MetricSummary]],
    *,
    ranked: Sequence[MetricInfo] = RANKED_METRICS,
) -> Iterator[str]:
    """Yield sentences on what the data cannot decide, and the smallest differences that they can.

    Args:
        dataset: Its name.
        sequences: Number of sequences that were scored.
        recordings: Number of recordings that they come from.
        methods: The scores of each method.
        ranked: The metrics by which methods of the benchmark are ranked.
    """
    reason = why_undecided(sequences, recordings)
    if reason:
        yield f"{dataset} cannot be decided: {reason}."
    if recordings < FEWEST_FOR_TEST:
        return
    found: dict[str, list[float]] = {}
    for metrics in methods:
        for metric in metrics:
            if metric.detectable is not None:
                found.setdefault(metric.metric, []).append(metric.detectable)
    texts = [_detectable_text(info, median(found[info.id])) for info in ranked if info.id in found]
    if texts:
        yield (
            "Smallest difference between two unrelated methods of this spread that would be found in four of five"
            f" repetitions, at the first step of Holm's correction for {len(ranked)} metrics:"
            f" {', '.join(texts)}."
        )

    rate = next((info for info in ranked if info.unit == "rate" and found.get(info.id)), None)
    if rate is not None:
        needed = [
            recordings_needed(
                median(found[rate.id]),
                points / 100,
                recordings=recordings,
                comparisons=len(ranked),
                power=POWER,
            )
            for points in POINTS
        ]
        yield (
            f"{rate.title}: to find {_listed(POINTS)} points as surely, about {_listed(needed)} recordings like these"
            " are needed."
        )


def why_undecided(sequences: int, recordings: int) -> str:
    """Say why nothing can be decided on so few data; empty if something can."""
    if recordings < FEWEST_FOR_TEST:
        plural = "" if recordings == 1 else "s"
        return f"{recordings} recording{plural}, where a comparison of methods needs {FEWEST_FOR_TEST}"
    if sequences < FEWEST_RANKED:
        return f"{sequences} sequences, where a ranking needs {FEWEST_RANKED}"
    return ""


def _listed(numbers: Sequence[int]) -> str:
    *first, last = map(str, numbers)
    return f"{', '.join(first)} and {last}"


def _detectable_text(info: MetricInfo, detectable: float) -> str:
    """A metric with its smallest detectable difference, or that there is none."""
    if info.unit == "rate" and detectable > 1:
        return f"{info.title} none (not even 100 points)"
    if info.unit == "rate":
        return f"{info.title} {info.scale * detectable:.0f} points"
    return f"{info.title} {info.scale * detectable:.2g}{printed_unit(info.unit)}"
