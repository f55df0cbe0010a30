"""The charts' points from scores: error over the horizon, and the value of gaze over the time before the event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from prbench.harness.intervals import Estimate
from prbench_benchmarks.motion_prediction.charts import ChartPanel, ChartPoint
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.published_numbers import TableRow
from prbench_benchmarks.motion_prediction.references import GROUND_TRUTH
from prbench_benchmarks.motion_prediction.scoring import Scores
from prbench_benchmarks.motion_prediction.tables.estimates import estimates
from prbench_benchmarks.motion_prediction.tables.gaze_value import ValueOfCondition, lead_of

_HORIZON_TITLES = {"ade": "mean error up to the horizon (best sample)", "fde": "error at the horizon (best sample)"}
_VALUE_TITLES = {
    "ade": "mean error (best sample)",
    "wrist_to_goal": "nearer wrist to the goal at the event (best sample)",
}


def horizon_panels(rows: Sequence[TableRow], scores: Mapping[str, Scores]) -> tuple[ChartPanel, ...]:
    """Errors of every row but GazeMoDiff's ablations up to, and at, the horizons of the protocol."""
    panels = []
    shown = [row for row in rows if row.name in scores and not row.is_ablation]
    summaries = {row.label: estimates(scores[row.name]) for row in shown if row.method != GROUND_TRUTH}
    for metric, title in _HORIZON_TITLES.items():
        lines = {}
        for label, summary in summaries.items():
            points = [
                _point(seconds, summary[f"{metric}@{seconds:g}s"])
                for seconds in load_prediction_protocol().evaluation.horizons
                if f"{metric}@{seconds:g}s" in summary
            ]
            if points:
                lines[label] = points
        panels.append(ChartPanel(title, "seconds after the last observed frame", "m over the flattened pose", lines))
    return tuple(panels)


def value_panels(values: Sequence[ValueOfCondition]) -> tuple[ChartPanel, ...]:
    """Paired differences between conditions over the time from the last observed frame to the event.

    Windows that slide have no such time; then there is nothing to draw.
    """
    panels = []
    for metric, title in _VALUE_TITLES.items():
        lines: dict[str, list[ChartPoint]] = {}
        for each in values:
            lead = lead_of(each.anchor)
            if lead is not None and each.metric == metric:
                label = f"{each.method}: {each.less.value} → {each.more.value}"
                lines.setdefault(label, []).append(_point(lead, each.comparison.difference))
        lines = {label: sorted(points, key=lambda point: point.at) for label, points in lines.items()}
        panels.append(
            ChartPanel(
                title, "seconds before the event", "change, m (below 0: better)", lines, ruled_at=0.0, reversed_x=True
            )
        )
    return tuple(panels)


def _point(at: float, estimate: Estimate) -> ChartPoint:
    return ChartPoint(at, estimate.mean, estimate.low, estimate.high)
