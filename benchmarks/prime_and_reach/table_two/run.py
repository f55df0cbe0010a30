"""Work through the rows of Table 2, unattended.

``plan.json`` is written first and holds the number of sequences; every row is a run folder of its own, which resumes.
The batches of all rows are generated side by side, those of the most expensive rows first; then each row is scored. A
row that cannot be run is skipped with a reason, one that fails ends nothing but itself and is tried again by the next
call.
Whatever moment the table was killed at, the same request goes on and ends with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec

from prbench.board import collect_runs, make_leaderboard
from prbench.board.tables import Leaderboard, of_all_methods
from prbench.engine import Engine, InProcess
from prbench.errors import StorageError
from prbench.files.storage import remove_leftovers, sole_writer
from prbench.harness.request import ProgressCallback, silent
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder
from prbench.harness.run_folder.record import TableRecord
from prbench.harness.verification import CheckedSummary, RunChecker
from prbench.tables import Table, write_tables
from prbench_benchmarks.prime_and_reach.study.methods import methods_table
from prbench_benchmarks.prime_and_reach.table_two.budget import (
    even_batch_size,
    kind,
    open_plan,
    split_lengths,
    with_limit,
)
from prbench_benchmarks.prime_and_reach.table_two.request import PlannedRow, TableRequest, plan_rows
from prbench_benchmarks.prime_and_reach.table_two.side_by_side import Counting, generate_side_by_side, why

MARKDOWN = "table_2.md"
JSON = "table_2.json"


def _uncounted(done: int, total: int, name: str) -> None:
    """Say nothing."""


def _as_just_scored(run: RunFolder, table: TableRecord) -> CheckedSummary:
    """Take scores that this very call has made or held against the motions."""
    return replace(RunChecker().check(run, table), unverified="")


@dataclass(frozen=True)
class Say:
    """Progress messages of a table; silent by default."""

    notice: Callable[[str], None] = lambda _: None
    """One line that stays: what is skipped, what has failed, how many sequences there will be."""
    timing: Callable[[], AbstractContextManager[Counting]] = lambda: nullcontext(_uncounted)
    """Shows which rows have had a first batch timed."""
    generating: Callable[[], AbstractContextManager[Counting]] = lambda: nullcontext(_uncounted)
    """Shows which rows have been generated."""
    row: Callable[[PlannedRow], AbstractContextManager[ProgressCallback]] = lambda _: nullcontext(silent)
    """Shows the progress of one row."""


@dataclass(frozen=True)
class TableReport:
    """A table that is through."""

    folder: Path
    tables: list[Table]
    """A part for each dataset; a table of notes alone where no row has numbers."""
    failed: dict[str, str]
    """Maps rows that were to be run and have no numbers to the reason."""


def run_table(request: TableRequest, *, engine: Engine | None = None, say: Say | None = None) -> TableReport:
    """Run what is missing of a table and lay it out; also written as ``table_2.md`` and ``table_2.json``.

    Args:
        request: What to run on what.
        engine: Where batches are generated and scored; in this process by default.
        say: Where to say how far it has got.

    Raises:
        AdapterError: if a method refuses its options.
        RunError: if the folder belongs to another request.
        StorageError: if a file cannot be written, or another process is working on the folder.
        TableError: if a table is missing, empty, changed or of an unknown version.
        UsageError: if the request does not fit together.
    """
    engine = engine or InProcess()
    say = say or Say()
    tables = request.tables()
    folder = request.folder()
    lengths = [split_lengths(table, request.split) for table in tables]
    planned = plan_rows(request, tuple(table.folder for table in tables), folder)
    notes = []
    with sole_writer(folder):
        # Under the lock and before the first row: what the plan decides must not change when the table resumes.
        plan = open_plan(folder, request.deciding(tables), limit=request.limit, minutes=request.minutes)
        for row in planned:
            if row.skipped is not None:
                notes.append(f"{row.label} ({row.condition.value}): skipped, {row.skipped}")
                say.notice(notes[-1])
        if plan.limit is None:
            with say.timing() as counting:
                plan = with_limit(plan, request, tables, planned, engine=engine, counting=counting, folder=folder)
        limit = plan.limit
        assert limit is not None
        counts = ", ".join(
            f"{table.info.dataset} n = {min(limit, len(own))} of {len(own)}"
            for table, own in zip(tables, lengths, strict=True)
        )
        expected = f"about {max(1.0, (plan.expected_seconds or 0.0) / 60):.0f} min"
        if plan.minutes is None:
            say.notice(f"{counts} (--limit {limit})")
        elif plan.fits:
            within = f"what fits into {plan.minutes} min here, {expected} expected"
            say.notice(f"{counts}: {within} (--minutes; --limit N says n outright)")
            notes.insert(0, f"n is what fitted into {plan.minutes} min on the machine that it was run on.")
        else:
            asked = f"{expected}, more than the {plan.minutes} min asked for (--minutes)"
            say.notice(f"{counts}: the fewest there can be; {asked}")

        # Generate all rows, the most expensive first: a short batch at the end leaves workers idle for less long.
        runnable = [row for row in planned if row.skipped is None]
        batch_size = request.batch_size or even_batch_size(limit, lengths)
        seconds = {name: cost.seconds_per_frame for name, cost in plan.costs.items()}
        ordered = sorted(runnable, key=lambda row: -seconds.get(kind(row), 0.0))
        runs = {row.name: replace(row.run, limit=limit, batch_size=batch_size) for row in ordered}
        with say.generating() as counting:
            failed, broken = generate_side_by_side(runs, engine, counting=counting)
        if broken is not None:
            say.notice(f"{broken} Going on row by row.")
        # Score each row, and generate what is still missing; only if nothing can be written all of the table ends.
        finished = []
        for row in runnable:
            if row.name not in failed:
                try:
                    with say.row(row) as progress:
                        finished.append(run_method(runs[row.name], engine=engine, progress=progress).folder.path)
                    continue
                except StorageError:
                    raise
                except Exception as error:  # a defect of a method, which must not cost the other rows
                    failed[row.name] = why(error)
            notes.append(f"{row.label} ({row.condition.value}): failed, {failed[row.name]}")
            say.notice(notes[-1])

        parts = [Table(number="2", title="nothing could be run", notes=tuple(notes))]
        if finished:
            board = make_leaderboard(collect_runs(finished, check=_as_just_scored))
            # A table of the common sequences takes the place of that of all: one line, one set of sequences.
            board = Leaderboard(of_all_methods(board.tables), board.macro, board.notes)
            parts = methods_table(board, "2", with_published=False, named=True)
            parts[-1] = msgspec.structs.replace(parts[-1], notes=(*parts[-1].notes, *notes))
        for name in (MARKDOWN, JSON):
            remove_leftovers(folder / name)  # of a process that was killed while it wrote them
            write_tables(parts, folder / name)  # last, after all rows: a table on disk is a finished one
    return TableReport(folder, parts, failed)
