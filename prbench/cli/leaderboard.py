"""``prbench leaderboard``: finished runs side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, Group, command, note
from prbench.cli.options import PATH, data_option, out_file_option, out_folder_option, workers_option
from prbench.cli.summaries import DatasetScores, dataset_scores, print_summary
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.leaderboard.comparison import ComparedMetric
    from prbench.leaderboard.tables import Leaderboard
    from prbench.submitted.verification import RunChecker

_EXAMPLE = "prbench leaderboard export runs/static runs/ground-truth --format md --out leaderboard.md"

leaderboard = Group(
    "leaderboard",
    sections={
        "commands": {
            "export": "prbench.cli.leaderboard:export",
            "compare": "prbench.cli.leaderboard:compare",
            "pareto": "prbench.cli.pareto:pareto",
            "merge": "prbench.cli.leaderboard:merge",
        }
    },
    example=_EXAMPLE,
    help="Put finished runs side by side.",
)


class BoardMetric(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One metric of one row of a leaderboard.

    Attributes:
        metric: Id of the metric, such as ``prime_success``.
        title: Its name in tables.
        unit: ``rate`` (from 0 to 1), ``ratio``, or a unit such as ``m``.
        mean: Mean over sequences.
        low: Lower bound of the interval of the mean; null where the data support none.
        high: Upper bound of the interval.
        level: Confidence level of the interval, such as 0.95.
        interval: Name of the estimator of the interval.
        sequences: Number of sequences behind the mean.
        recordings: Number of recordings that they come from.
        marks: What a reader of the interval needs to know: ``few_recordings``, ``one_recording``, ``all_equal``.
        flags: Number of motions that carry each remark.
        detectable: Smallest difference to an unrelated method of the same spread that is found with 80 % power, among
            the main metrics; null where nothing can be tested.
        uncertainty: Shares of the mean's variance that come from ``recordings``, ``sequences`` and ``samples``.
    """

    metric: str
    title: str
    unit: str
    mean: float | None
    low: float | None
    high: float | None
    level: float
    interval: str
    sequences: int
    recordings: int
    marks: list[str]
    flags: dict[str, int]
    detectable: float | None
    uncertainty: dict[str, float]


class BoardCost(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The cost of a motion, on the machine of the run; null where nothing was measured or declared.

    Attributes:
        seconds_per_motion: Seconds a motion, batched as the run was.
        passes_per_motion: Network passes a motion, as the method declares.
        memory_mebibytes: Largest memory of the device, else of the process, in MiB.
        parameters: Parameters of the method's networks.
    """

    seconds_per_motion: float | None
    passes_per_motion: float | None
    memory_mebibytes: float | None
    parameters: int | None


class BoardRow(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One run in the table of a dataset.

    Attributes:
        run: Name of the run folder.
        method: Name of the method.
        kind: ``built-in``, ``package``, ``program``, ``file``, ``control`` or ``unknown``: how it was reached.
        package: Package that the method was installed from, the program's command, or the name of the motions' file.
        isolation: How the method was kept apart (``process``, ``bubblewrap`` or ``container``); null if it was not.
        mark: A remark about its motions that readers must know; empty if there is none.
        version: Version of the package.
        weights_digest: Digest of its weights; null without weights.
        condition: What the method was given.
        control: ``shuffled-goal`` if it was given other sequences' goals; null if not.
        variant: Control, weights, options and the like, by which rows of one method differ.
        seed: Seed of the run.
        samples: Number of motions of each sequence.
        scored: Number of sequences behind the numbers.
        verified: Whether the scores were held against the motions.
        why_unverified: The reason why not; empty if they were.
        unsupported: Number of sequences that are longer than the method can generate.
        ranks: Maps ids of metrics to ranks: one more than the number of methods that are better by a supported
            difference; empty where nothing is ranked.
        leads: Ids of metrics in which it is better than every other method, each by a supported difference.
        metrics: The scores.
        cost: Cost of a motion.
        says_nothing: Ids of metrics that say nothing about this method, because it stands still.
    """

    run: str
    method: str
    kind: str
    package: str
    isolation: str | None
    mark: str
    version: str
    weights_digest: str | None
    condition: str
    control: str | None
    variant: str
    seed: int
    samples: int
    scored: int
    verified: bool
    why_unverified: str
    unsupported: int
    ranks: dict[str, int]
    leads: list[str]
    metrics: list[BoardMetric]
    cost: BoardCost
    says_nothing: list[str]


class BoardTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Runs on one dataset that compare: protocol, table, split and sequences agree.

    Attributes:
        dataset: Name of the dataset.
        title: The same for readers; holds the word "synthetic" where the data are.
        synthetic: Whether the data are synthetic.
        redistribution: Whether the licence lets recorded motion be passed on.
        protocol_digest: Digest of the rules by which the rows were scored.
        identity_digest: Digest of the table's sequences and their ids.
        content_digest: Digest of the table's content.
        split: Split of the table.
        selection_digest: Digest of the chosen sequences.
        own_protocol: Name and version of a protocol of the user's own; empty for prbench's.
        chosen_sequences: Number of the chosen sequences; above ``sequences`` where the table is of those alone that
            every method generated.
        left_sequences_out: Methods that left chosen sequences out, with how many.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        undecided: Sentences on what the data cannot decide, and the smallest differences that they can.
        rows: The runs, sorted by condition, controls last.
    """

    dataset: str
    title: str
    synthetic: bool
    redistribution: str
    protocol_digest: str
    identity_digest: str
    content_digest: str
    split: str
    selection_digest: str
    own_protocol: str
    chosen_sequences: int
    left_sequences_out: list[str]
    sequences: int
    recordings: int
    undecided: list[str]
    rows: list[BoardRow]


class MacroMean(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Means of one method over several datasets, each dataset counting alike.

    Attributes:
        method: Name of the method.
        kind: Whose method it is, in words.
        mark: A remark about its motions that readers must know; empty if there is none.
        condition: What the method was given.
        variant: Control, weights, options and the like, by which rows of one method differ.
        means: Maps ids of metrics to means; empty if the method lacks a dataset.
        ranks: Maps ids of metrics to ranks, from 1; empty where nothing is ranked.
        verified: Whether the scores on all datasets were held against the motions.
        missing: Datasets that the method lacks.
    """

    method: str
    kind: str
    mark: str
    condition: str
    variant: str
    means: dict[str, float | None]
    ranks: dict[str, int]
    verified: bool
    missing: list[str]


class MacroMeans(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Methods over all datasets of one protocol.

    Attributes:
        datasets: Names of the datasets.
        synthetic: Whether one of them is synthetic.
        rows: The methods.
    """

    datasets: list[str]
    synthetic: bool
    rows: list[MacroMean]


class PublishedDifference(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A measured number beside the one that the study prints: rates in %, lengths in metres.

    Attributes:
        table: Table of the study, such as ``2``.
        dataset: Name of the dataset.
        condition: What the method was given.
        method: Name of the method.
        variant: Of the measured row.
        published_variant: Of the study's row that it stands beside.
        metric: Id of the metric.
        unit: ``%``, ``m`` or ``ratio``.
        measured: The measured number.
        published: The study's number.
        difference: measured - published.
        low: Lower bound of the difference's 95 % interval; null where the measured number has none.
        high: Upper bound of the interval.
        sequences: Number of sequences behind the measured number.
        published_sequences: Number of sequences in the study's test split.
        verified: Whether the measured scores were held against the motions.
        assumptions: Ids of what the study leaves open and could explain the difference.
        remarks: What else could.
        source: Where the study prints the number.
    """

    table: str
    dataset: str
    condition: str
    method: str
    variant: str
    published_variant: str
    metric: str
    unit: str
    measured: float
    published: float
    difference: float
    low: float | None
    high: float | None
    sequences: int
    published_sequences: int
    verified: bool
    assumptions: list[str]
    remarks: list[str]
    source: str


class Board(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A leaderboard; ``--format json`` writes the same.

    Attributes:
        schema_version: Version of this shape.
        tables: One table for each dataset and way of scoring it.
        macro_means: Means over datasets, for each protocol with two datasets or more.
        notes: What was left out, and which tables must not be compared.
        published: With ``--with-published``: differences to the study's numbers, on real recordings only; absent if
            there are none.
        assumptions: Maps the ids that they name to what the study leaves open; absent if there are none.
        not_beside_published: A sentence for each run beside which no published number stands; absent without.
    """

    schema_version: int
    tables: list[BoardTable]
    macro_means: list[MacroMeans]
    notes: list[str]
    published: list[PublishedDifference] = []
    assumptions: dict[str, str] = {}
    not_beside_published: list[str] = []


class BoardReport(msgspec.Struct, frozen=True, kw_only=True):
    """An exported leaderboard.

    Attributes:
        format: ``md``, ``csv`` or ``json``: what ``out`` is written in.
        out: The file; null if the leaderboard was printed.
        board: The leaderboard.
    """

    format: str
    out: Path | None
    board: Board


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


def _tables_option(function: Callable) -> Callable:
    return data_option(
        required=False,
        help="The tables of the runs: scores are held against the motions on them, and called unverified without; the"
        " embedded tables need not be named.",
    )(function)


@command("export", example=_EXAMPLE, report=BoardReport)
@click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")
@click.option(
    "--format",
    type=click.Choice(["md", "csv", "json"]),
    default="md",
    help="Markdown (default), CSV or JSON.",
)
@out_file_option("Write the leaderboard to this file instead of printing it.")
@click.option(
    "--with-published",
    is_flag=True,
    help="Show the study's numbers behind the measured ones, and how far runs on real recordings are from them.",
)
@_tables_option
@workers_option()
def export(
    runs: tuple[Path, ...], format: str, out: Path | None, with_published: bool, data: tuple[Path, ...], workers: int
) -> Answer:
    """Write a leaderboard of finished runs.

    RUN are run folders, or folders that hold some.
    """
    from prbench import leaderboard as boards
    from prbench.locks import sole_writer
    from prbench.storage import write_text

    collected = boards.collect_runs(runs, check=_checker(data, workers).check)
    for reason in collected.left_out:
        note(f"left out: {reason}")
    for row in collected.rows:
        if row.unverified:
            note(f"unverified: {row.run}: {row.unverified}")
    board = boards.make_leaderboard(collected)
    text = _exported(board, format, with_published=with_published)
    if out is not None:
        with sole_writer(out):
            write_text(out, text)
    exported = msgspec.json.decode(_exported(board, "json", with_published=with_published), type=Board)
    report = BoardReport(format=format, out=out, board=exported)
    return Answer(report, lambda: print(text, end="") if out is None else print(f"leaderboard: {out}"))


def _exported(board: Leaderboard, format: str, *, with_published: bool) -> str:
    """Write a leaderboard in a format, with the study's numbers behind it if asked for."""
    from prbench import leaderboard as boards

    text = boards.export(board, format)
    if not with_published:
        return text
    from prbench.workflows.study.beside import add_published

    return add_published(text, board, format)


@command(
    "compare",
    example="prbench leaderboard compare runs/static runs/scripted",
    report=CompareReport,
    writes_report=True,
)
@click.argument("first", type=PATH, metavar="RUN")
@click.argument("second", type=PATH, metavar="RUN")
@_tables_option
@workers_option()
def compare(first: Path, second: Path, data: tuple[Path, ...], workers: int) -> Answer:
    """Say where two runs on the same sequences differ, and whether the data support it."""
    from prbench.leaderboard import compare_runs

    compared = compare_runs(first, second, checker=_checker(data, workers))
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


def _checker(data: Sequence[Path], workers: int) -> RunChecker:
    """Make what scores again on the named tables and the embedded ones."""
    from prbench.engine import engine_for
    from prbench.submitted.verification import RunChecker
    from prbench.workflows.first_run import table_finder

    return RunChecker(table_finder(data), engine_for(workers))


def _compared_run(path: Path, datasets: list[str]) -> ComparedRun:
    """Name the method of a run and its origin, and the datasets for which it handed in recorded motions."""
    from prbench.runs import DatasetSummary, RunFolder

    run = RunFolder.open(path)
    marks = {name: DatasetSummary.read(run.dataset(name).path).recorded_motion_mark for name in datasets}
    return ComparedRun(
        path=path,
        method=run.record.method.name,
        origin=run.record.method.origin,
        marks={name: mark for name, mark in marks.items() if mark},
    )


def _metric_difference(row: ComparedMetric) -> MetricDifference:
    from prbench.evaluation.comparisons import POINTS

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
    detectable = "–" if row.detectable is None else f"{row.detectable * scale:.2f}{unit}"
    power = ", ".join(f"{100 * share:.0f}" for share in row.power.values()) or "–"
    return (row.dataset, row.title, change, bounds, p_value, detectable, power, said)


class MergeReport(msgspec.Struct, frozen=True, kw_only=True):
    """The runs of all folds as one.

    Attributes:
        runs: Their folders.
        scores: The merged scores.
        unverified: A sentence for each run whose scores could not be held against the motions.
        out: The folder of the merged run, which `prbench leaderboard export` shows; null if none was asked for.
    """

    runs: list[Path]
    scores: DatasetScores
    unverified: list[str]
    out: Path | None


@command(
    "merge",
    example="prbench leaderboard merge runs/fold-1 runs/fold-2 runs/fold-3 --out runs/folds",
    report=MergeReport,
)
@click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")
@out_folder_option("Write them as a run folder, which `prbench leaderboard export` and `compare` put beside others.")
@_tables_option
@workers_option()
def merge(runs: tuple[Path, ...], out: Path | None, data: tuple[Path, ...], workers: int) -> Answer:
    """Put the scores of a method's runs on the folds of one dataset together.

    The runs are made by `prbench run --split participants --fold K/N`, one for each K.
    """
    from prbench.leaderboard.merging import merge_folds

    merged = merge_folds(runs, checker=_checker(data, workers))
    protocol = merged.folds[0].protocol
    if protocol is not None and protocol.is_own:
        note(f"scored under a protocol of your own, {protocol.label}: no number here is the study's")
    if out is not None:
        merged.write(out)
    method = merged.record.method
    scores = dataset_scores(merged.summary, None, motionless=method.motionless)
    report = MergeReport(runs=list(runs), scores=scores, unverified=list(merged.unverified), out=out)

    def show() -> None:
        print_summary(merged.summary, origin=method.origin, motionless=method.motionless)
        for reason in merged.unverified:
            print(f"unverified: {reason}")
        if out is not None:
            print(f"run folder: {out}")

    return Answer(report, show)
