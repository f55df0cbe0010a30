"""``prbench leaderboard export``: finished runs side by side."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.arguments import add_workers, command
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.submitted.verification import RunChecker

_EXAMPLE = "prbench leaderboard export runs/static runs/ground-truth --format md --out leaderboard.md"


def add_parser(commands: argparse._SubParsersAction) -> None:
    """Register the command group."""
    parser = command(
        commands,
        "leaderboard",
        summary="put finished runs side by side",
        example=_EXAMPLE,
        execute=lambda _: (parser.print_help(), 2)[1],
    )
    group = parser.add_subparsers(metavar="COMMAND")
    export = command(
        group,
        "export",
        summary="write a leaderboard of finished runs",
        example=_EXAMPLE,
        execute=_export,
    )
    export.add_argument("runs", type=Path, nargs="+", metavar="RUN", help="run folders, or folders that hold some")
    export.add_argument("--format", choices=["md", "csv", "json"], default="md", help="default: md")
    export.add_argument("--out", type=Path, metavar="FILE", help="write it there instead of printing it")
    _add_tables(export)
    comparison = command(
        group,
        "compare",
        summary="say where two runs on the same sequences differ, and whether the data support it",
        example="prbench leaderboard compare runs/static runs/scripted",
        execute=_compare,
    )
    comparison.add_argument("first", type=Path, metavar="RUN", help="a finished run folder")
    comparison.add_argument("second", type=Path, metavar="RUN", help="another one, of the same sequences")
    _add_tables(comparison)


def _add_tables(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data",
        type=Path,
        nargs="+",
        default=(),
        metavar="DIR",
        help="the tables of the runs: scores are held against the motions on them, and called unverified without;"
        " the embedded tables need not be named",
    )
    add_workers(parser)


def _compare(arguments: argparse.Namespace) -> int:
    from prbench.leaderboard import compare_runs
    from prbench.metrics import printed_unit

    rows = []
    compared = compare_runs(arguments.first, arguments.second, checker=_checker(arguments))
    for row in compared.metrics:
        difference = row.comparison.difference
        p = row.comparison.adjusted_p_value
        scale = row.info.scale
        unit = " points" if row.info.unit == "rate" else printed_unit(row.info.unit)
        if "all_equal" in difference.marks:
            bounds = "all equal"  # a bootstrap of equal differences would claim certainty
        elif difference.low is None or difference.high is None:
            bounds = "–"
        else:
            bounds = f"[{difference.low * scale:+.2f}, {difference.high * scale:+.2f}]"
        conclusion = row.comparison.conclusion
        said = conclusion if conclusion.startswith("not") else f"{arguments.first.name} is {conclusion}"
        change = f"{difference.mean * scale:+.2f}{unit}"
        rows.append((row.dataset, row.info.title, change, bounds, "–" if p is None else f"{p:.4f}", said))
    print_table(
        f"{arguments.first.name} against {arguments.second.name}, sequence by sequence",
        ("dataset", "metric", "difference", "95 % interval", "p (Holm)", ""),
        rows,
        numbers=(2, 3, 4),
    )
    for path in (arguments.first, arguments.second):
        print("\n".join(_described(path, sorted({row.dataset for row in compared.metrics}))))
    for reason in compared.unverified:
        print(f"unverified: {reason}")
    return 0


def _described(path: Path, datasets: list[str]) -> list[str]:
    """Name the method of a run and its origin, and the datasets for which it handed in recorded motions."""
    from prbench.runs import DatasetSummary, RunFolder

    run = RunFolder.open(path)
    lines = [f"{path.name}: {run.record.method.name}, {run.record.method.origin}"]
    for name in datasets:
        mark = DatasetSummary.read(run.dataset(name).path).recorded_motion_mark
        if mark:
            lines.append(f"{path.name}, {name}: {mark}.")
    return lines


def _checker(arguments: argparse.Namespace) -> RunChecker:
    """Make what scores again on the named tables and the embedded ones."""
    from prbench.engine import engine_for
    from prbench.submitted.verification import RunChecker
    from prbench.workflows.first_run import table_finder

    return RunChecker(table_finder(arguments.data), engine_for(arguments.workers))


def _export(arguments: argparse.Namespace) -> int:
    from prbench.leaderboard import collect_runs, export, make_leaderboard
    from prbench.locks import sole_writer
    from prbench.storage import write_text

    collected = collect_runs(arguments.runs, check=_checker(arguments).check)
    for reason in collected.left_out:
        print(f"left out: {reason}", file=sys.stderr)
    for row in collected.rows:
        if row.unverified:
            print(f"unverified: {row.run}: {row.unverified}", file=sys.stderr)
    text = export(make_leaderboard(collected), arguments.format)
    if arguments.out is None:
        print(text, end="")
        return 0
    with sole_writer(arguments.out):
        write_text(arguments.out, text)
    print(f"leaderboard: {arguments.out}")
    return 0
