"""Results as rows of text for a terminal: what to print, not how."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from prbench.metrics import METRICS
from prbench.runs.summary import DatasetSummary, MetricSummary

_MARKS = {
    "few_recordings": "few recordings",
    "one_recording": "one recording",
    "all_equal": "all equal",
}
_MAIN = {info.id for info in METRICS if info.main}
_HIGHER = {info.id: info.higher_is_better for info in METRICS}
_ARROWS = {True: "↑", False: "↓", None: ""}


@dataclass(frozen=True)
class ResultRow:
    """One metric of one dataset, as printed."""

    metric: str
    """Title, with an arrow towards the better."""
    value: str
    interval: str
    remarks: str
    main: bool
    """One of the six of the study."""


@dataclass(frozen=True)
class ResultTable:
    """One dataset's results, as printed."""

    title: str
    """Method, condition, dataset; carries the word "synthetic" where the data are."""
    footnotes: tuple[str, ...]
    rows: tuple[ResultRow, ...]


COLUMNS = ("metric", "value", "95 % interval", "remarks")


def result_tables(summaries: Iterable[DatasetSummary]) -> tuple[ResultTable, ...]:
    """A table for each dataset of a run, main metrics first."""
    return tuple(_table(summary) for summary in summaries)


def format_value(value: float, unit: str) -> str:
    """A rate as a percentage, everything else as it is, two decimals."""
    return f"{100 * value:.2f} %" if unit == "rate" else f"{value:.2f}{' m' if unit == 'm' else ''}"


def format_interval(metric: MetricSummary) -> str:
    """The interval in the unit of the value, or a dash where the data support none."""
    if metric.low is None or metric.high is None:
        return "–"
    scale = 100 if metric.unit == "rate" else 1
    return f"{scale * metric.low:.2f} … {scale * metric.high:.2f}"


def _table(summary: DatasetSummary) -> ResultTable:
    control = f", {summary.control}" if summary.control else ""
    title = (
        f"{summary.method} ({summary.condition}{control}) on {summary.title}, {summary.split}:"
        f" {_counted(summary.sequences - summary.unsupported, 'sequence')},"
        f" {_counted(summary.recordings, 'recording')}"
    )
    if summary.samples > 1:
        title += f", {summary.samples} samples each"
    return ResultTable(title, tuple(_footnotes(summary)), tuple(_row(metric) for metric in summary.metrics))


def _row(metric: MetricSummary) -> ResultRow:
    flags = [f"{count} {name.replace('_', ' ')}" for name, count in metric.flags.items()]
    return ResultRow(
        metric=f"{metric.title} {_ARROWS[_HIGHER.get(metric.metric)]}".rstrip(),
        value=format_value(metric.mean, metric.unit),
        interval=format_interval(metric),
        remarks=", ".join([*(_MARKS.get(mark, mark) for mark in metric.marks), *flags]),
        main=metric.metric in _MAIN,
    )


def _footnotes(summary: DatasetSummary) -> Iterable[str]:
    if summary.synthetic:
        yield "Scores on synthetic data say nothing about real people."
    if summary.unsupported:
        yield f"{_counted(summary.unsupported, 'sequence')} longer than the method can generate: not scored."
    if summary.length_mismatches:
        yield f"{_counted(summary.length_mismatches, 'motion')} of another length than the recorded one."
    if summary.redistribution == "none":
        yield "The licence of this dataset does not allow passing on recorded motion; the run folder may hold some."


def _counted(number: int, name: str) -> str:
    return f"{number} {name}{'' if number == 1 else 's'}"
