"""What commands share that read finished runs: the tables that they are held against, and what was left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.cli.commands import note
from prbench.cli.options import data_option

if TYPE_CHECKING:
    from prbench.board.collect import CollectedRuns
    from prbench.harness.verification import RunChecker


def tables_option(function: Callable) -> Callable:
    """Add ``--data DIR…``: the tables that runs were made on."""
    return data_option(
        required=False,
        help="The tables of the runs: scores are held against the motions on them, and called unverified without; the"
        " embedded tables need not be named.",
    )(function)


def run_checker(data: Sequence[Path], workers: int) -> RunChecker:
    """Make what scores again on the named tables and the embedded ones."""
    from prbench.engine import engine_for
    from prbench.harness.first_run import table_finder
    from prbench.harness.verification import RunChecker

    return RunChecker(table_finder(data), engine_for(workers))


def collected_runs(
    runs: Sequence[Path], data: Sequence[Path], workers: int, *, any_benchmark: bool = False
) -> CollectedRuns:
    """Collect finished runs, whose scores are held against their motions, and tell what was left out or not checked.

    Args:
        runs: Run folders, or folders that hold some.
        data: Tables of the runs.
        workers: Number of processes.
        any_benchmark: The command knows runs of every benchmark.
    """
    from prbench.board import collect_runs

    collected = collect_runs(runs, check=run_checker(data, workers).check, any_benchmark=any_benchmark)
    for reason in collected.left_out:
        note(f"left out: {reason}")
    for row in collected.rows:
        if row.unverified:
            note(f"unverified: {row.run}: {row.unverified}")
    return collected
