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
from dataclasses import dataclass
from pathlib import Path

from prbench.engine import Engine, InProcess
from prbench.errors import StorageError
from prbench.files.storage import remove_leftovers, sole_writer, write_json, write_text
from prbench.harness.request import ProgressCallback, RunRequest, silent
from prbench.harness.run import run_method
from prbench.sequences import SequenceTable
from prbench_benchmarks.prime_and_reach.table_two.as_markdown import as_builtins, as_markdown
from prbench_benchmarks.prime_and_reach.table_two.budget import DatasetSize, even_batch_size, kind
from prbench_benchmarks.prime_and_reach.table_two.layout import RowOutcome, TableLayout, lay_out
from prbench_benchmarks.prime_and_reach.table_two.plan import PlannedRow, plan_rows
from prbench_benchmarks.prime_and_reach.table_two.request import TableRequest
from prbench_benchmarks.prime_and_reach.table_two.side_by_side import Counting, generate_side_by_side, why
from prbench_benchmarks.prime_and_reach.table_two.state import TablePlan, dataset_size, open_plan, with_limit

MARKDOWN = "table_2.md"
JSON = "table_2.json"


def _uncounted(done: int, total: int, name: str) -> None:
    """Say nothing."""


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
    layout: TableLayout
    outcomes: tuple[RowOutcome, ...]

    @property
    def failed(self) -> tuple[RowOutcome, ...]:
        """Rows that were to be run and have no numbers."""
        return tuple(outcome for outcome in self.outcomes if outcome.state == "failed")


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
    sizes = [dataset_size(table, request.split) for table in tables]
    planned = plan_rows(request, tuple(table.folder for table in tables), folder)
    with sole_writer(folder):
        # Under the lock and before the first row: what the plan decides must not change when the table resumes.
        plan = open_plan(folder, request.deciding(tables), limit=request.limit, minutes=request.minutes)
        for row in planned:
            if row.skipped is not None:
                say.notice(f"{row.label} ({row.condition.value}): skipped, {row.skipped}")
        if plan.limit is None:
            with say.timing() as counting:
                plan = with_limit(plan, request, tables, planned, engine=engine, counting=counting, folder=folder)
        assert plan.limit is not None
        say.notice(_shown_limit(plan, tables, sizes))
        batch_size = request.batch_size or even_batch_size(plan.limit, sizes)
        runs = {row.name: row.limited(plan.limit, batch_size) for row in _most_expensive_first(planned, plan)}
        # Generate all rows, then finish each; what is wrong with one is put down and said.
        with say.generating() as counting:
            made = generate_side_by_side(runs, engine, counting=counting)
        if made.broken is not None:
            say.notice(f"{made.broken} Going on row by row.")
        outcomes = tuple(
            RowOutcome(row, "skipped", row.skipped)
            if row.skipped is not None
            else _outcome(row, runs[row.name], made.failed.get(row.name), engine, say)
            for row in planned
        )
        # A table that could not fit must not claim that it is what fitted.
        minutes = plan.minutes if plan.fits else None
        layout = lay_out(outcomes, tables=tables, split=request.split, limit=plan.limit, minutes=minutes)
        for name in (MARKDOWN, JSON):
            remove_leftovers(folder / name)  # of a process that was killed while it wrote them
        # Written last, after all rows: a table on disk is a finished one.
        write_text(folder / MARKDOWN, as_markdown(layout))
        write_json(folder / JSON, as_builtins(layout))
    return TableReport(folder, layout, outcomes)


def _most_expensive_first(planned: list[PlannedRow], plan: TablePlan) -> list[PlannedRow]:
    """Rows to be run; a short batch at the end leaves the other worker idle for less long than a long one."""

    def seconds(row: PlannedRow) -> float:
        cost = plan.costs.get(kind(row))
        return 0.0 if cost is None else cost.seconds_per_frame

    return sorted((row for row in planned if row.skipped is None), key=seconds, reverse=True)


def _outcome(planned: PlannedRow, run: RunRequest, failed: str | None, engine: Engine, say: Say) -> RowOutcome:
    """Score one row, and generate what is still missing; only if nothing can be written all of the table ends."""
    reason = failed
    if reason is None:
        try:
            with say.row(planned) as progress:
                report = run_method(run, engine=engine, progress=progress)
        except StorageError:
            raise
        except Exception as error:  # a defect of a method, which must not cost the other rows
            reason = why(error)
        else:
            return RowOutcome(planned, "run", folder=report.folder.path)
    say.notice(f"{planned.label} ({planned.condition.value}): failed, {reason}")
    return RowOutcome(planned, "failed", reason)


def _shown_limit(plan: TablePlan, tables: list[SequenceTable], sizes: list[DatasetSize]) -> str:
    counts = ", ".join(
        f"{table.info.dataset} n = {min(plan.limit or size.sequences, size.sequences)} of {size.sequences}"
        for table, size in zip(tables, sizes, strict=True)
    )
    if plan.minutes is None:
        return f"{counts} (--limit {plan.limit})"
    expected = f"about {max(1.0, (plan.expected_seconds or 0.0) / 60):.0f} min"
    if not plan.fits:
        return f"{counts}: the fewest there can be; {expected}, more than the {plan.minutes} min asked for (--minutes)"
    return (
        f"{counts}: what fits into {plan.minutes} min here, {expected} expected (--minutes; --limit N says n outright)"
    )
