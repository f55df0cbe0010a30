"""``prbench leaderboard pareto``: scores against cost, drawn."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from prbench.cli.checked_runs import collected_runs
from prbench.cli.commands import Answer, command, note
from prbench.cli.options import PATH, data_option, out_file_option, workers_option
from prbench.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from prbench.board.collect import LeaderboardRow
    from prbench.metrics import MetricInfo
    from prbench.viewing.pareto import ScoredMethod

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
