"""``prbench leaderboard``: finished runs side by side.

``prbench leaderboard export``: a leaderboard of finished runs.

``prbench leaderboard compare``: two runs, sequence by sequence.

``prbench leaderboard pareto``: scores against cost, drawn.

``prbench audit``: what cheats and controls earn under each metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.commands import Answer, Group, command, note, progress, session
from prbench.cli.options import (
    FIRST_RUN_SEQUENCES,
    PATH,
    collected_runs,
    data_option,
    embedded_tables,
    limit_option,
    out_file_option,
    out_folder_option,
    run_checker,
    split_option,
    tables_option,
    workers_option,
)
from prbench.cli.summaries import phi_cell
from prbench.cli.terminal import print_table, shown_width
from prbench.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from prbench.board.audit import ControlMeans, TableAudit
    from prbench.board.collect import LeaderboardRow
    from prbench.board.comparison import ComparedMetric
    from prbench.board.tables import Leaderboard
    from prbench.metrics import MetricInfo
    from prbench.viewing.pareto import ScoredMethod


EXAMPLE = "prbench leaderboard export runs/static runs/ground-truth --format md --out leaderboard.md"

leaderboard = Group(
    "leaderboard",
    sections={
        "commands": {
            "export": "prbench.cli.leaderboard:export",
            "compare": "prbench.cli.leaderboard:compare",
            "pareto": "prbench.cli.leaderboard:pareto",
        }
    },
    example=EXAMPLE,
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
            the metrics that are compared; null where nothing can be tested.
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
        samples: Number of motions kept of each sequence.
        best_of: Number of motions drawn for each that was kept.
        gaze: Whether the motions bring gaze that the method generated.
        obstacles: Whether the method was given the solid boxes around each sequence.
        carry_on: Whether every put starts where the generated pick before it ends.
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
    best_of: int
    gaze: bool
    obstacles: bool
    carry_on: bool
    scored: int
    verified: bool
    why_unverified: str
    unsupported: int
    ranks: dict[str, int]
    leads: list[str]
    metrics: list[BoardMetric]
    cost: BoardCost
    says_nothing: list[str]


class BoardTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
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
        benchmark: Name of the benchmark; absent for prime-and-reach.
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
    benchmark: str = ""


class MacroMean(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Means of one method over several datasets, each dataset counting alike.

    Attributes:
        method: Name of the method.
        kind: Whose method it is, in words.
        mark: A remark about its motions that readers must know; empty if there is none.
        condition: What the method was given.
        variant: Control, weights, options and the like, by which rows of one method differ.
        means: Maps ids of metrics to means; empty if the method lacks a dataset.
        intervals: Maps ids of metrics to the two bounds of the mean's 95 % interval, where each dataset has one.
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
    intervals: dict[str, list[float]]
    ranks: dict[str, int]
    verified: bool
    missing: list[str]


class MacroMeans(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """Methods over all datasets of one protocol.

    Attributes:
        datasets: Names of the datasets.
        synthetic: Whether one of them is synthetic.
        rows: The methods.
        benchmark: Name of the benchmark; absent for prime-and-reach.
    """

    datasets: list[str]
    synthetic: bool
    rows: list[MacroMean]
    benchmark: str = ""


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


@command("export", example=EXAMPLE, report=BoardReport)
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
@tables_option
@workers_option()
def export(
    runs: tuple[Path, ...], format: str, out: Path | None, with_published: bool, data: tuple[Path, ...], workers: int
) -> Answer:
    """Write a leaderboard of finished runs.

    RUN are run folders, or folders that hold some.
    """
    from prbench import board as boards
    from prbench.files.storage import sole_writer, write_text

    board = boards.make_leaderboard(collected_runs(runs, data, workers, any_benchmark=True))
    text = _exported(board, format, with_published=with_published)
    if out is not None:
        with sole_writer(out):
            write_text(out, text)
    exported = msgspec.json.decode(_exported(board, "json", with_published=with_published), type=Board)
    report = BoardReport(format=format, out=out, board=exported)
    return Answer(report, lambda: print(text, end="") if out is None else print(f"leaderboard: {out}"))


def _exported(board: Leaderboard, format: str, *, with_published: bool) -> str:
    """Write a leaderboard in a format, with the study's numbers behind it if asked for."""
    from prbench import board as boards

    text = boards.export(board, format)
    if not with_published:
        return text
    from prbench.workflows.study.beside import add_published

    return add_published(text, board, format)


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


_COSTS = {
    "seconds": "seconds a motion",
    "passes": "network passes a motion",
    "memory": "memory (MiB)",
    "parameters": "parameters",
}


class ParetoMethod(msgspec.Struct, frozen=True, kw_only=True):
    """One method of the plot.

    Attributes:
        name: Its name and variant.
        score: Mean in the printed unit (rates in %).
        cost: Cost; null for a control, or where none was measured.
        on_front: No other method is as cheap and better.
    """

    name: str
    score: float
    cost: float | None
    on_front: bool


class ParetoReport(msgspec.Struct, frozen=True, kw_only=True):
    """Scores against cost.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric.
        against: ``seconds``, ``passes``, ``memory`` or ``parameters``.
        methods: One entry a run.
        out: The picture.
    """

    dataset: str
    metric: str
    against: str
    methods: list[ParetoMethod]
    out: Path


@command(
    "pareto", example="prbench leaderboard pareto runs/pr runs/mdm runs/static --out pareto.svg", report=ParetoReport
)
@click.argument("runs", type=PATH, nargs=-1, required=True, metavar="RUN...")
@click.option("--metric", default="prime_success", metavar="ID", help="Metric of the score (default prime_success).")
@click.option("--against", type=click.Choice(list(_COSTS)), default="seconds", help="Which cost (default seconds).")
@out_file_option("Write the plot as PNG or SVG.", required=True)
@data_option(required=False, help="Tables of the runs, on which their scores are checked; the embedded ones are known.")
@workers_option()
def pareto(
    runs: tuple[Path, ...], metric: str, against: str, out: Path, data: tuple[Path, ...], workers: int
) -> Answer:
    """Draw scores against cost, and the methods that none beats in both.

    RUN are run folders of the same sequences, or folders that hold some. Controls have no cost and are level lines.
    """
    from prbench.viewing.pareto import ParetoAxes, draw_pareto, pareto_front, require_drawable

    require_drawable(out)
    info = _metric(metric)
    rows, title = _rows(runs, data, workers)
    methods = [found for row in rows if (found := _scored(row, info, against)) is not None]
    higher = bool(info.higher_is_better)
    unit = "%" if info.unit == "rate" else info.unit
    axes = ParetoAxes(
        title=title, score=f"{info.title}{info.arrow} ({unit})", cost=_COSTS[against], higher_is_better=higher
    )
    draw_pareto(methods, axes, out)
    front = pareto_front(methods, higher_is_better=higher)
    report = ParetoReport(
        dataset=rows[0].summary.dataset,
        metric=info.id,
        against=against,
        methods=[
            ParetoMethod(name=each.name, score=each.score, cost=each.cost, on_front=each in front) for each in methods
        ],
        out=out,
    )

    def show() -> None:
        print(f"not beaten in both {info.title} and {_COSTS[against]}: {', '.join(each.name for each in front)}")
        print("a front of means: whether two methods differ is said by `prbench leaderboard compare`")
        print(f"plot: {out}")

    return Answer(report, show)


def _metric(name: str) -> MetricInfo:
    from prbench.metrics import METRICS

    known = {info.id: info for info in METRICS if info.higher_is_better is not None}
    if name not in known:
        raise UsageError(
            f"--metric: unknown metric '{name}', or one without a better side.{did_you_mean(name, list(known))} Known"
            f" ones are: {', '.join(known)}."
        )
    return known[name]


def _rows(runs: tuple[Path, ...], data: tuple[Path, ...], workers: int) -> tuple[list[LeaderboardRow], str]:
    """Return the rows of the one table that all runs belong to, and its title.

    Raises:
        UsageError: if the runs do not compare.
    """
    from prbench import board as boards
    from prbench.board.tables import of_all_methods

    board = boards.make_leaderboard(collected_runs(runs, data, workers))
    # Where a method left sequences out, all are shown on those that every one generated.
    tables = of_all_methods(board.tables)
    if len(tables) != 1:
        raise UsageError(
            f"expected runs on the same sequences of one dataset, found {len(tables)} tables."
            f" {' '.join(board.notes)} Name runs that compare."
        )
    table = tables[0]
    for row in table.rows:
        if row.entry.unverified:
            note(f"unverified: {row.entry.run}: {row.entry.unverified}")
    of = f" of {table.of} that every method here generated" if table.of else ""
    own = f", own protocol {table.protocol}" if table.protocol else ""
    title = f"{table.title}: {table.sequences} sequences{of}, split {table.split}{own}"
    return [row.entry for row in table.rows], title


def _scored(row: LeaderboardRow, info: MetricInfo, against: str) -> ScoredMethod | None:
    from prbench.harness.run_folder.summary import TWICE_DAGGER
    from prbench.viewing.pareto import ScoredMethod

    metric = row.metric(info.id)
    if metric is None:
        return None
    costs = {
        "seconds": row.cost.seconds,
        "passes": row.cost.network_passes,
        "memory": row.cost.memory_mebibytes,
        "parameters": row.cost.parameters,
    }
    cost = None if row.is_control else costs[against]
    if cost is None and not row.is_control:
        note(f"left out: {row.run}: its {_COSTS[against]} are not known")
        return None
    name = f"{row.method} ({row.record.condition})" if not row.is_control else row.method
    if row.summary.run_marks:
        note(f"{row.run}: {row.mark}")
        chosen = f", best of {row.record.best_of}" if row.record.best_of > 1 else ""
        name = f"{name}{chosen} {row.summary.run_symbols}"
    # Copies of the recorded motion are no method: they are shown with their mark and stand on no front.
    if row.summary.hands_in_recordings:
        note(f"{row.run}: {row.mark}")
        cost = None
        name = f"{name} {TWICE_DAGGER}"
    return ScoredMethod(
        name=name,
        score=metric.mean * info.scale,
        low=None if metric.low is None else metric.low * info.scale,
        high=None if metric.high is None else metric.high * info.scale,
        cost=cost,
    )


_COLUMNS = 8
"""Metrics side by side at most; half as many on a narrow terminal."""
_WIDE = 120
"""Columns of a terminal that these metrics take."""
_SEQUENCES = 48
"""Sequences of each dataset that is named with ``--data``, unless the user says how many."""


class AuditReport(msgspec.Struct, frozen=True, kw_only=True):
    """What each metric pays for.

    Attributes:
        tables: One entry a table.
        means: Means over all tables, one entry a control.
        as_good_as_people: Maps each metric to the controls whose means are as good as those of recorded people or
            better, though they are none; metrics that compare with the recorded motion, and those without a direction,
            are left out.
        out: Folder of the run folders; null if they were not kept.
    """

    tables: tuple[TableAudit, ...]
    means: tuple[ControlMeans, ...]
    as_good_as_people: dict[str, list[str]]
    out: Path | None


@command("audit", example="prbench audit --data tables/adt --limit 100", report=AuditReport)
@data_option(required=False, help="Built dataset folder(s); without it the five embedded synthetic ones are used.")
@split_option()
@limit_option(f"{_SEQUENCES}; {FIRST_RUN_SEQUENCES} without --data")
@out_folder_option("Keep the run folders in this one (default: they are thrown away).")
@workers_option()
def audit(data: tuple[Path, ...], split: str, limit: int | None, out: Path | None, workers: int) -> Answer:
    """Print what cheats, controls and recorded people earn under each metric.

    Of several tables it prints means of the main metrics; with -v of all metrics, and each table.
    Every cheat can be run by itself, too: `prbench run --method tremor`. docs/audit.md says what is to be learnt.
    """
    from prbench.board.audit import audit as run_audit
    from prbench.board.audit import means_of_controls
    from prbench.engine import engine_for

    engine = engine_for(workers)
    default = _SEQUENCES if data else FIRST_RUN_SEQUENCES
    tables = data or embedded_tables(engine)
    with progress("running controls") as show:
        found = run_audit(tables, split=split, limit=limit or default, out=out, engine=engine, progress=show)
    over = means_of_controls(found)
    report = AuditReport(tables=found, means=over, as_good_as_people=_as_good_as_people(over), out=out)

    def show_all() -> None:
        if len(found) > 1:
            _print_means(found, over)
        if len(found) == 1 or session().verbose:
            for each in found:
                _print_dataset(each)
        if any(each.recorded.synthetic for each in found):
            print("These are scores on synthetic data: never compare them with published ones.")
        print("docs/audit.md says what each control does and what is to be learnt from it.")
        if out is not None:
            print(f"run folders: {out}")

    return Answer(report, show_all)


def _as_good_as_people(controls: Sequence[ControlMeans]) -> dict[str, list[str]]:
    """Map each metric in which scoring like people can be told from being compared with them to who does."""
    from prbench.board.audit import metrics_of, not_worse_than_people

    contests = [
        info for info in metrics_of(controls) if info.higher_is_better is not None and not info.compares_with_recorded
    ]
    return {info.id: list(not_worse_than_people(controls, info)) for info in contests}


def _print_means(tables: Sequence[TableAudit], over: Sequence[ControlMeans]) -> None:
    first = tables[0].recorded
    numbers = sorted({each.recorded.sequences for each in tables})
    counts = str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
    title = f"Means over {len(tables)} datasets, {counts} sequences of each, split {first.split}"
    _print_all_metrics(title, over, only_main=not session().verbose)
    print("With -v, or with --json: other metrics, each dataset, and agreement with recorded people.")


def _print_dataset(each: TableAudit) -> None:
    summary = each.recorded
    title = f"{summary.title}: {summary.sequences} sequences of {summary.recordings} recordings, split {summary.split}"
    _print_all_metrics(title, each.means)
    _print_agreement(each)
    for control in each.controls:
        if control.summary.edge_arrivals:
            print(f"{control.name}: {control.summary.edge_arrivals}.")


def _print_all_metrics(title: str, controls: Sequence[ControlMeans], *, only_main: bool = False) -> None:
    """Print what every control earns, and in which metrics it does no worse than recorded people."""
    from prbench.board.audit import metrics_of

    metrics = metrics_of(controls)
    columns = _COLUMNS if shown_width() >= _WIDE else _COLUMNS // 2
    for kind, infos in (
        (f"{title}; the main metrics", [info for info in metrics if info.main]),
        ("beside them", [info for info in metrics if not info.main and not only_main]),
    ):
        for first in range(0, len(infos), columns):
            _print_metrics(kind, controls, infos[first : first + columns])
    titles = {info.id: info.title for info in metrics}
    for metric, names in _as_good_as_people(controls).items():
        if names:
            print(f"{titles[metric]}: no worse than recorded people: {', '.join(names)}.")


def _print_agreement(each: TableAudit) -> None:
    """Print on which sequences each control succeeds, beside recorded people."""
    rates = each.controls[0].agreement.rates
    header = ["control", *(rate.title.replace(" ", "\n") for rate in rates)]
    rows = []
    for control in each.controls:
        found = {rate.metric: rate for rate in control.agreement.rates}
        cells = [phi_cell(found[rate.metric]) if rate.metric in found else "–" for rate in rates]
        rows.append((control.name, *cells))
    title = "agreement with recorded people on the same sequences (phi, 95 % interval; 0 is unrelated)"
    print_table(title, header, rows, numbers=range(1, len(header)))


def _print_metrics(title: str, controls: Sequence[ControlMeans], metrics: Sequence[MetricInfo]) -> None:
    from prbench.metrics import printed_unit

    header = ["control"]
    for info in metrics:
        unit = printed_unit(info.unit).strip()
        words = f"{info.title}{info.arrow}".replace(" ", "\n")
        header.append(f"{words}\n({unit})" if unit else words)
    rows = []
    for control in controls:
        found = [control.means.get(info.id) for info in metrics]
        cells = [
            "–" if mean is None else f"{mean.mean * info.scale:.2f}" for mean, info in zip(found, metrics, strict=True)
        ]
        rows.append((control.name, *cells))
    print_table(title, header, rows, numbers=range(1, len(header)))
