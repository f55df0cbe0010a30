"""``prbench leaderboard compare``: two runs, sequence by sequence."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.checked_runs import run_checker, tables_option
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import PATH, workers_option
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.board.comparison import ComparedMetric


class ComparedRun(msgspec.Struct, frozen=True, kw_only=True):
    """One of two runs.

    Attributes:
        path: Its folder.
        method: Name of the method.
        origin: Whose method it is, in words.
        marks: Maps datasets to remarks about the motions that readers must know.
    """

    path: Path
    method: str
    origin: str
    marks: dict[str, str]


class MetricDifference(msgspec.Struct, frozen=True, kw_only=True):
    """The difference of two runs in one metric on one dataset: first minus second, over the same sequences.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric, such as ``prime_success``.
        title: Its name in tables.
        unit: ``rate`` (differences from -1 to 1), ``ratio``, or a unit such as ``m``.
        difference: Mean difference over sequences.
        low: Lower bound of its 95 % interval; null where the data support none.
        high: Upper bound of its 95 % interval.
        interval: Name of the estimator of the interval.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        marks: What a reader of the interval needs to know: ``few_recordings``, ``one_recording``, ``all_equal``.
        p_value: Two-sided, from the spread between recordings; null where it cannot be tested.
        adjusted_p_value: The same after Holm's correction for everything compared here.
        detectable: Smallest true difference that is found with 80 % power at Holm's first step; null where it cannot be
            tested.
        power: Maps differences in points to the probability that a true one of this size would be found at Holm's first
            step; empty but for rates that can be tested.
        conclusion: ``higher``, ``lower``, ``not supported by the data`` or ``cannot be tested``: of the first run.
    """

    dataset: str
    metric: str
    title: str
    unit: str
    difference: float | None
    low: float | None
    high: float | None
    interval: str
    sequences: int
    recordings: int
    marks: list[str]
    p_value: float | None
    adjusted_p_value: float | None
    detectable: float | None
    power: dict[str, float]
    conclusion: str


class CompareReport(msgspec.Struct, frozen=True, kw_only=True):
    """Two runs, compared sequence by sequence.

    Attributes:
        first: The first run.
        second: The second run.
        differences: One entry for each metric and dataset.
        unverified: A sentence for each run and dataset whose scores could not be held against the motions.
    """

    first: ComparedRun
    second: ComparedRun
    differences: list[MetricDifference]
    unverified: list[str]


@command(
    "compare",
    example="prbench leaderboard compare runs/static runs/scripted",
    report=CompareReport,
    writes_report=True,
)
@click.argument("first", type=PATH, metavar="RUN")
@click.argument("second", type=PATH, metavar="RUN")
@tables_option
@workers_option()
def compare(first: Path, second: Path, data: tuple[Path, ...], workers: int) -> Answer:
    """Say where two runs on the same sequences differ, and whether the data support it."""
    from prbench.board import compare_runs

    compared = compare_runs(first, second, checker=run_checker(data, workers))
    for line in compared.left_out:
        note(line)
    datasets = sorted({row.dataset for row in compared.metrics})
    report = CompareReport(
        first=_compared_run(first, datasets),
        second=_compared_run(second, datasets),
        differences=[_metric_difference(row) for row in compared.metrics],
        unverified=list(compared.unverified),
    )
    return Answer(report, lambda: _print_comparison(report))


def _compared_run(path: Path, datasets: list[str]) -> ComparedRun:
    """Name the method of a run and its origin, and the datasets for which it handed in recorded motions."""
    from prbench.harness.run_folder import DatasetSummary, RunFolder

    run = RunFolder.open(path, any_benchmark=True)
    marks = {name: DatasetSummary.read(run.dataset(name).path).mark for name in datasets}
    return ComparedRun(
        path=path,
        method=run.record.method.name,
        origin=run.record.method.origin,
        marks={name: mark for name, mark in marks.items() if mark},
    )


def _metric_difference(row: ComparedMetric) -> MetricDifference:
    from prbench.harness.comparisons import POINTS

    difference = row.comparison.difference
    return MetricDifference(
        dataset=row.dataset,
        metric=row.info.id,
        title=row.info.title,
        unit=row.info.unit,
        difference=difference.mean,
        low=difference.low,
        high=difference.high,
        interval=difference.method,
        sequences=difference.n_sequences,
        recordings=difference.n_recordings,
        marks=list(difference.marks),
        p_value=row.comparison.p_value,
        adjusted_p_value=row.comparison.adjusted_p_value,
        detectable=row.comparison.detectable,
        power={str(points): power for points, power in zip(POINTS, row.comparison.power)},
        conclusion=row.comparison.conclusion,
    )


def _print_comparison(report: CompareReport) -> None:
    first = report.first.path.name
    print_table(
        f"{first} against {report.second.path.name}, sequence by sequence",
        ("dataset", "metric", "difference", "95 % interval", "p (Holm)", "detectable", "power", ""),
        [_difference_row(first, row) for row in report.differences],
        numbers=(2, 3, 4, 5, 6),
    )
    print("detectable: smallest true difference that is found in four of five repetitions, at Holm's first step.")
    if any(row.power for row in report.differences):
        points = next(", ".join(row.power) for row in report.differences if row.power)
        print(f"power: in % of repetitions, true differences of {points} points are found there.")
    for run in (report.first, report.second):
        print(f"{run.path.name}: {run.method}, {run.origin}")
        for dataset, mark in run.marks.items():
            print(f"{run.path.name}, {dataset}: {mark}.")
    for reason in report.unverified:
        print(f"unverified: {reason}")


def _difference_row(first: str, row: MetricDifference) -> tuple[str, ...]:
    from prbench.metrics import printed_scale, printed_unit

    scale = printed_scale(row.unit)
    unit = " points" if row.unit == "rate" else printed_unit(row.unit)
    if row.low is None or row.high is None:
        bounds = "all equal" if "all_equal" in row.marks else "cannot be given"
    else:
        bounds = f"[{row.low * scale:+.2f}, {row.high * scale:+.2f}]"
    said = f"{first} is {row.conclusion}" if row.conclusion in ("higher", "lower") else row.conclusion
    change = "–" if row.difference is None else f"{row.difference * scale:+.2f}{unit}"
    p_value = "–" if row.adjusted_p_value is None else f"{row.adjusted_p_value:.4f}"
    if row.detectable is None:
        detectable = "–"
    elif row.unit == "rate" and row.detectable > 1:
        detectable = "none"  # no difference of two rates is larger than 100 points
    else:
        detectable = f"{row.detectable * scale:.2f}{unit}"
    power = ", ".join(f"{100 * share:.0f}" for share in row.power.values()) or "–"
    return (row.dataset, row.title, change, bounds, p_value, detectable, power, said)
