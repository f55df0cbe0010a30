"""``prbench leaderboard export`` and ``compare``: finished runs side by side; ``prbench audit``: what cheats earn."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from prbench.cli import options as opt
from prbench.cli.board import say_what_licences_keep
from prbench.cli.commands import Answer, Group, command, note, progress, session
from prbench.cli.summaries import phi_cell
from prbench.cli.terminal import print_table
from prbench.datasets import ON_SYNTHETIC_DATA, SYNTHETIC_PREFIX
from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.board.audit import ControlMeans, TableAudit
    from prbench.board.comparison import RunComparison


EXAMPLE = "prbench leaderboard export runs/static runs/ground-truth --format md --out leaderboard.md"

# The module of each command, where it is not that of boards.
_MODULES = {"export": "leaderboard", "compare": "leaderboard", "site": "site"}


def _places(*names: str) -> dict[str, str]:
    return {name: f"prbench.cli.{_MODULES.get(name, 'board')}:{name}" for name in names}


_SECTIONS = {
    "commands": _places("export", "compare", "submit", "verify", "site"),
    "boards in a folder": _places("init", "add", "withdraw", "history", "build", "check", "cite"),
}
leaderboard = Group("leaderboard", sections=_SECTIONS, example=EXAMPLE, help="Put finished runs side by side.")


@command("export", example=EXAMPLE, report="prbench.board.export:Board")
@click.argument("runs", type=opt.PATH, nargs=-1, required=True, metavar="RUN...")
@opt.choice_option("--format", ["md", "csv", "json"], "Markdown (default), CSV or JSON.", default="md")
@opt.out_file_option("Write the leaderboard to this file instead of printing it.")
@opt.tables_option
@opt.signed_option
@click.option(
    "--training",
    multiple=True,
    type=click.Choice(["none", "declared", "overlapping", "undeclared"]),
    help="Only methods whose training data are declared so, and controls; repeatable.",
)
@opt.workers_option()
def export(runs: tuple[Path, ...], format: str, out: Path | None, training: tuple[str, ...], **given: Any) -> Answer:
    """Write a leaderboard of finished runs.

    RUN are run folders, folders that hold some, or a board of `prbench leaderboard init`.
    """
    from prbench import board as boards
    from prbench.board.collect import with_training
    from prbench.board.export import as_board
    from prbench.files.storage import sole_writer, write_text

    collected = opt.collected_runs(runs, **given, any_benchmark=True)
    board = boards.make_leaderboard(with_training(collected, training) if training else collected)
    say_what_licences_keep(board.tables)
    text = boards.export(board, format)
    if out is not None:
        with sole_writer(out):
            write_text(out, text)
    return Answer(as_board(board), lambda: print(text, end="") if out is None else print(f"leaderboard: {out}"))


_COMPARE = "prbench leaderboard compare runs/static runs/scripted"


@command("compare", example=_COMPARE, report="prbench.board.comparison:RunComparison")
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
    from prbench.board.comparison import difference_texts

    first = compared.first.path.name
    title = f"{first} against {compared.second.path.name}, sequence by sequence"
    header = ("dataset", "metric", "difference", "95 % interval", "p (Holm)", "detectable", "")
    rows = []
    for row in compared.metrics:
        conclusion = f"{first} is {row.conclusion}" if row.conclusion in ("higher", "lower") else row.conclusion
        rows.append((row.dataset, row.info.title, *difference_texts(row), conclusion))
    print_table(title, header, rows, numbers=(2, 3, 4, 5))
    print("detectable: smallest true difference that is found in four of five repetitions, at Holm's first step.")
    if any(row.conclusion == "cannot be tested" for row in compared.metrics):
        needed = compared.metrics[0].comparison.needed
        print(f"cannot be tested: {needed} recordings (of folds: participants) or more are needed for so many metrics.")
    for run in (compared.first, compared.second):
        print(f"{run.path.name}: {run.method}, {run.origin} (declared)")
        for dataset, mark in run.marks.items():
            print(f"{run.path.name}, {dataset}: {mark}.")
    for reason in compared.unverified:
        print(f"unverified: {reason}")
    if any(row.dataset.startswith(SYNTHETIC_PREFIX) for row in compared.metrics):
        print(ON_SYNTHETIC_DATA)


# Metrics side by side at most; half as many on a narrow terminal.
_COLUMNS = 9
# Columns of a terminal that these metrics take.
_WIDE = 120
# Sequences of each dataset that is named with ``--data``, unless the user says how many.
_SEQUENCES = 48
# Motions that a search tries for each column.
_EVALUATIONS = 480


_SEARCH = "Search for motions that earn more than people, in every column or in one, such as mpjpe."


@command("audit", example="prbench audit --data tables/adt --limit 100", report=["prbench.board.audit:TableAudit"])
@click.argument("runs", type=opt.PATH, nargs=-1, metavar="[RUN]...")
@opt.data_option(required=False, help="Built dataset folder(s); without it the five embedded synthetic ones are used.")
@opt.split_option()
@opt.limit_option(f"{_SEQUENCES}; {opt.FIRST_RUN_SEQUENCES} without --data")
@opt.out_folder_option("Keep the run folders in this one (default: they are thrown away).")
@opt.workers_option()
@click.option("--search", is_flag=False, flag_value="all", metavar="[COLUMN]", help=_SEARCH)
@opt.number_option("--evaluations", f"With --search: motions tried for each column (default {_EVALUATIONS}).")
@opt.seed_option("of --search", default=None)
def audit(runs: tuple[Path, ...], data: tuple[Path, ...], out: Path | None, search: str | None, **given: Any) -> Answer:
    """Print what cheats, controls and recorded people earn under each metric, and finished runs beside them.

    Of several tables it prints means of the main metrics; with -v of all metrics, and each table.
    Every cheat can be run by itself, too: `prbench run --method tremor`. docs/audit.md says what is to be learnt.
    With --search it also tries cheats that nobody has thought of: on 50 sequences in about 5 minutes of two cores.
    """
    from prbench.board import cheat_search
    from prbench.board.audit import audit as run_audit
    from prbench.board.audit import means_of_controls
    from prbench.engine import engine_for

    columns = cheat_search.searched_columns(search or cheat_search.EVERY_COLUMN)
    if search is None and (given["evaluations"], given["seed"]) != (None, None):
        raise UsageError("--evaluations and --seed belong to --search; add it, or leave them out.")

    engine = engine_for(given["workers"])
    default = _SEQUENCES if data else opt.FIRST_RUN_SEQUENCES
    tables = data or opt.embedded_tables(engine)
    chosen = {"split": given["split"], "limit": given["limit"] or default}
    with progress("running controls") as show:
        found = list(run_audit(tables, runs=runs, **chosen, out=out, engine=engine, progress=show))
    if search is not None:
        with progress("searching for cheats") as show:
            judged = cheat_search.judged_tables(tables, **chosen)
            tried = {"evaluations": given["evaluations"] or _EVALUATIONS, "seed": given["seed"] or 0}
            best = cheat_search.search(judged, columns, **tried, engine=engine, progress=show)
        found = [replace(each, found=own) for each, own in zip(found, best, strict=True)]

    def show_all() -> None:
        first = found[0].recorded
        if len(found) > 1:
            numbers = sorted({each.recorded.sequences for each in found})
            counts = str(numbers[0]) if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
            title = f"Means over {len(found)} datasets, {counts} sequences of each, split {first.split}"
            _print_all_metrics(title, means_of_controls(found), only_main=not session().verbose)
            print("With -v, or with --json: other metrics, each dataset, and agreement with recorded people.")
        if len(found) == 1 or session().verbose:
            for each in found:
                _print_dataset(each)
        for motion in found[0].found:
            print(f"{motion.name}: " + ", ".join(f"{name}={value:g}" for name, value in motion.parameters.items()))
        if any(each.recorded.synthetic for each in found):
            print(ON_SYNTHETIC_DATA)
        print("docs/audit.md says what each control does and what is to be learnt from it.")
        if out is not None:
            print(f"run folders: {out}")

    return Answer(found, show_all)


def _print_dataset(each: TableAudit) -> None:
    """Print what every control earns on one table, and on which sequences it succeeds, beside recorded people."""
    summary = each.recorded
    title = f"{summary.title}: {summary.sequences} sequences of {summary.recordings} recordings, split {summary.split}"
    _print_all_metrics(title, each.means)
    rates = each.controls[0].agreement.rates
    header = ["control", *(rate.title.replace(" ", "\n") for rate in rates)]
    rows = []
    for control in each.controls:
        found = {rate.metric: rate for rate in control.agreement.rates}
        rows.append((control.name, *(phi_cell(found.get(rate.metric)) for rate in rates)))
    title = "agreement with recorded people on the same sequences (phi, 95 % interval; 0 is unrelated)"
    print_table(title, header, rows, numbers=range(1, len(header)))


def _print_all_metrics(title: str, controls: Sequence[ControlMeans], *, only_main: bool = False) -> None:
    """Print what every control earns, and in which metrics it does no worse than recorded people."""
    from prbench.board.audit import not_worse_than_people
    from prbench.harness.run_folder.summary import ARRIVAL
    from prbench.metrics import METRICS, printed_unit

    metrics = [info for info in METRICS if any(info.id in control.means for control in controls)]
    # Files and pipes have no width.
    narrow = sys.stdout.isatty() and shutil.get_terminal_size().columns < _WIDE
    columns = _COLUMNS // 2 if narrow else _COLUMNS
    for kind, infos in (
        # Arrival is what tells a look from a stare.
        (f"{title}; the main metrics", [info for info in metrics if info.main or info.id == ARRIVAL]),
        ("beside them", [info for info in metrics if not info.main and info.id != ARRIVAL and not only_main]),
    ):
        for first in range(0, len(infos), columns):
            shown = infos[first : first + columns]
            header = ["control"]
            for info in shown:
                unit = printed_unit(info.unit).strip()
                header.append(f"{info.title}{info.arrow}".replace(" ", "\n") + (f"\n({unit})" if unit else ""))
            rows = []
            for control in controls:
                means = [control.means.get(info.id) for info in shown]
                cells = (f"{mean.mean * info.scale:.2f}" if mean else "–" for mean, info in zip(means, shown))
                rows.append((control.name, *cells))
            print_table(kind, header, rows, numbers=range(1, len(header)))
    for info in metrics:
        names = not_worse_than_people(controls, info)
        if names:
            print(f"{info.title}: no worse than recorded people: {', '.join(names)}.")
