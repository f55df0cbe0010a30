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

from prbench.cli import options as opt
from prbench.cli.commands import Answer, Group, command, note, progress, session
from prbench.cli.summaries import phi_cell
from prbench.cli.terminal import print_table, shown_width
from prbench.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from prbench.board.audit import ControlMeans, TableAudit
    from prbench.board.collect import LeaderboardRow
    from prbench.board.comparison import ComparedMetric, RunComparison
    from prbench.board.export import Board
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
@click.argument("runs", type=opt.PATH, nargs=-1, required=True, metavar="RUN...")
@click.option(
    "--format", type=click.Choice(["md", "csv", "json"]), default="md", help="Markdown (default), CSV or JSON."
)
@opt.out_file_option("Write the leaderboard to this file instead of printing it.")
@opt.tables_option
@opt.workers_option()
def export(runs: tuple[Path, ...], format: str, out: Path | None, data: tuple[Path, ...], workers: int) -> Answer:
    """Write a leaderboard of finished runs.

    RUN are run folders, or folders that hold some.
    """
    from prbench import board as boards
    from prbench.board.export import as_board
    from prbench.files.storage import sole_writer, write_text

    board = boards.make_leaderboard(opt.collected_runs(runs, data, workers, any_benchmark=True))
    text = boards.export(board, format)
    if out is not None:
        with sole_writer(out):
            write_text(out, text)
    report = BoardReport(format=format, out=out, board=as_board(board))
    return Answer(report, lambda: print(text, end="") if out is None else print(f"leaderboard: {out}"))


@command(
    "compare",
    example="prbench leaderboard compare runs/static runs/scripted",
    report="prbench.board.comparison:RunComparison",
    writes_report=True,
)
@click.argument("first", type=opt.PATH, metavar="RUN")
@click.argument("second", type=opt.PATH, metavar="RUN")
@opt.tables_option
@opt.workers_option()
def compare(first: Path, second: Path, data: tuple[Path, ...], workers: int) -> Answer:
    """Say where two runs on the same sequences differ, and whether the data support it."""
    from prbench.board import compare_runs

    compared = compare_runs(first, second, checker=opt.run_checker(data, workers))
    for line in compared.left_out:
        note(line)
    return Answer(compared, lambda: _print_comparison(compared))


def _print_comparison(compared: RunComparison) -> None:
    from prbench.harness.intervals import POINTS

    first = compared.first.path.name
    print_table(
        f"{first} against {compared.second.path.name}, sequence by sequence",
        ("dataset", "metric", "difference", "95 % interval", "p (Holm)", "detectable", "power", ""),
        [_difference_row(first, row) for row in compared.metrics],
        numbers=(2, 3, 4, 5, 6),
    )
    print("detectable: smallest true difference that is found in four of five repetitions, at Holm's first step.")
    if any(row.comparison.power for row in compared.metrics):
        points = ", ".join(map(str, POINTS))
        print(f"power: in % of repetitions, true differences of {points} points are found there.")
    for run in (compared.first, compared.second):
        print(f"{run.path.name}: {run.method}, {run.origin}")
        for dataset, mark in run.marks.items():
            print(f"{run.path.name}, {dataset}: {mark}.")
    for reason in compared.unverified:
        print(f"unverified: {reason}")


def _difference_row(first: str, row: ComparedMetric) -> tuple[str, ...]:
    from prbench.metrics import printed_unit

    found = row.comparison
    scale = row.info.scale
    unit = " points" if row.info.unit == "rate" else printed_unit(row.info.unit)
    if found.difference.low is None or found.difference.high is None:
        bounds = "all equal" if "all_equal" in found.difference.marks else "cannot be given"
    else:
        bounds = f"[{found.difference.low * scale:+.2f}, {found.difference.high * scale:+.2f}]"
    said = f"{first} is {row.conclusion}" if row.conclusion in ("higher", "lower") else row.conclusion
    change = f"{found.difference.mean * scale:+.2f}{unit}"
    p_value = "–" if found.adjusted_p_value is None else f"{found.adjusted_p_value:.4f}"
    if found.detectable is None:
        detectable = "–"
    elif row.info.unit == "rate" and found.detectable > 1:
        detectable = "none"  # no difference of two rates is larger than 100 points
    else:
        detectable = f"{found.detectable * scale:.2f}{unit}"
    power = ", ".join(f"{100 * share:.0f}" for share in found.power) or "–"
    return (row.dataset, row.info.title, change, bounds, p_value, detectable, power, said)


_COSTS = {
    "seconds": "seconds a motion",
    "network_passes": "network passes a motion",
    "memory_mebibytes": "memory (MiB)",
    "parameters": "parameters",
}
"""Costs of a motion by the field of the record, as an axis says them."""
_SHORT_COSTS = {"passes": "network_passes", "memory": "memory_mebibytes"}


class ParetoReport(msgspec.Struct, frozen=True, kw_only=True):
    """Scores against cost.

    Attributes:
        dataset: Name of the dataset.
        metric: Id of the metric.
        against: ``seconds``, ``passes``, ``memory`` or ``parameters``.
        methods: One entry a run.
        front: Names of the methods than which no other is as cheap and better, the cheapest first.
        out: The picture.
    """

    dataset: str
    metric: str
    against: str
    methods: list[ScoredMethod]
    front: list[str]
    out: Path


@command(
    "pareto", example="prbench leaderboard pareto runs/pr runs/mdm runs/static --out pareto.svg", report=ParetoReport
)
@click.argument("runs", type=opt.PATH, nargs=-1, required=True, metavar="RUN...")
@click.option("--metric", default="prime_success", metavar="ID", help="Metric of the score (default prime_success).")
@click.option(
    "--against",
    type=click.Choice(["seconds", "passes", "memory", "parameters"]),
    default="seconds",
    help="Which cost (default seconds).",
)
@opt.out_file_option("Write the plot as PNG or SVG.", required=True)
@opt.tables_option
@opt.workers_option()
def pareto(
    runs: tuple[Path, ...], metric: str, against: str, out: Path, data: tuple[Path, ...], workers: int
) -> Answer:
    """Draw scores against cost, and the methods that none beats in both.

    RUN are run folders of the same sequences, or folders that hold some. Controls have no cost and are level lines.
    """
    from prbench import board as boards
    from prbench.board.tables import of_all_methods
    from prbench.metrics import METRICS
    from prbench.viewing.figures import require_drawable
    from prbench.viewing.pareto import ParetoAxes, draw_pareto, pareto_front

    require_drawable(out)
    known = {info.id: info for info in METRICS if info.higher_is_better is not None}
    if metric not in known:
        raise UsageError(
            f"--metric: unknown metric '{metric}', or one without a better side.{did_you_mean(metric, known)} Known"
            f" ones are: {', '.join(known)}."
        )
    info = known[metric]
    board = boards.make_leaderboard(opt.collected_runs(runs, data, workers))
    # Where a method left sequences out, all are shown on those that every one generated.
    tables = of_all_methods(board.tables)
    if len(tables) != 1:
        raise UsageError(
            f"expected runs on the same sequences of one dataset, found {len(tables)} tables."
            f" {' '.join(board.notes)} Name runs that compare."
        )
    table = tables[0]
    cost = _SHORT_COSTS.get(against, against)
    methods = [found for row in table.rows if (found := _scored(row.entry, info, cost)) is not None]
    of = f" of {table.of} that every method here generated" if table.of else ""
    own = f", own protocol {table.protocol}" if table.protocol else ""
    axes = ParetoAxes(
        title=f"{table.title}: {table.sequences} sequences{of}, split {table.split}{own}",
        score=f"{info.title}{info.arrow} ({'%' if info.unit == 'rate' else info.unit})",
        cost=_COSTS[cost],
        higher_is_better=bool(info.higher_is_better),
    )
    draw_pareto(methods, axes, out)
    front = [each.name for each in pareto_front(methods, higher_is_better=axes.higher_is_better)]
    report = ParetoReport(dataset=table.dataset, metric=info.id, against=against, methods=methods, front=front, out=out)

    def show() -> None:
        print(f"not beaten in both {info.title} and {axes.cost}: {', '.join(front)}")
        print("a front of means: whether two methods differ is said by `prbench leaderboard compare`")
        print(f"plot: {out}")

    return Answer(report, show)


def _scored(row: LeaderboardRow, info: MetricInfo, against: str) -> ScoredMethod | None:
    from prbench.harness.run_folder.summary import TWICE_DAGGER
    from prbench.viewing.pareto import ScoredMethod

    metric = row.metric(info.id)
    if metric is None:
        return None
    cost = None if row.is_control else getattr(row.cost, against)
    if cost is None and not row.is_control:
        note(f"left out: {row.run}: its {_COSTS[against]} are not known")
        return None
    name = f"{row.method} ({row.record.condition})" if not row.is_control else row.method
    if row.summary.run_marks:
        note(f"{row.run}: {row.mark}")
        name = f"{name} {row.summary.run_symbols}"
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
@opt.data_option(required=False, help="Built dataset folder(s); without it the five embedded synthetic ones are used.")
@opt.split_option()
@opt.limit_option(f"{_SEQUENCES}; {opt.FIRST_RUN_SEQUENCES} without --data")
@opt.out_folder_option("Keep the run folders in this one (default: they are thrown away).")
@opt.workers_option()
def audit(data: tuple[Path, ...], split: str, limit: int | None, out: Path | None, workers: int) -> Answer:
    """Print what cheats, controls and recorded people earn under each metric.

    Of several tables it prints means of the main metrics; with -v of all metrics, and each table.
    Every cheat can be run by itself, too: `prbench run --method tremor`. docs/audit.md says what is to be learnt.
    """
    from prbench.board.audit import audit as run_audit
    from prbench.board.audit import means_of_controls
    from prbench.engine import engine_for

    engine = engine_for(workers)
    default = _SEQUENCES if data else opt.FIRST_RUN_SEQUENCES
    tables = data or opt.embedded_tables(engine)
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
