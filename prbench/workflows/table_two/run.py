"""Work through the rows of Table 2, unattended.

``plan.json`` is written first and holds the number of sequences; every row is a run folder of its own, which resumes.
A row that cannot be run is skipped with a reason, one that fails ends nothing but itself and is tried again by the next
call. Whatever moment the table was killed at, the same request goes on and ends with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, StorageError
from prbench.evaluation.progress import ProgressCallback, silent
from prbench.evaluation.run import run_method
from prbench.sequences import SequenceTable
from prbench.storage import text_digest, write_json, write_text
from prbench.workflows.table_two.as_json import as_builtins
from prbench.workflows.table_two.as_markdown import as_markdown
from prbench.workflows.table_two.layout import RowOutcome, TableLayout, lay_out
from prbench.workflows.table_two.plan import PlannedRow, plan_rows
from prbench.workflows.table_two.request import TableRequest
from prbench.workflows.table_two.state import TablePlan, open_plan
from prbench.workflows.table_two.subset import dataset_size, with_limit

MARKDOWN, JSON = "table_2.md", "table_2.json"


Counting = Callable[[int, int, str], None]
"""Called with finished items, all items, and the next or last one's name."""


def _uncounted(done: int, total: int, name: str) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class Say:
    """Where a table says how far it has got; silent by default."""

    notice: Callable[[str], None] = lambda _: None
    """One line that stays: what is skipped, what has failed, how many sequences there will be."""
    timing: Callable[[], AbstractContextManager[Counting]] = lambda: nullcontext(_uncounted)
    """Shows which rows have had a first batch timed."""
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
        RunError: if the folder belongs to another request.
        StorageError: if a file cannot be written.
        TableError: if a table is missing, empty, changed or of an unknown version.
        UsageError: if the request does not fit together.
    """
    engine, say = engine or InProcess(), say or Say()
    tables = request.tables()
    folder = request.folder()
    asked = text_digest(*request.deciding(tables))
    plan = open_plan(folder, asked, limit=request.limit, minutes=request.minutes)
    planned = plan_rows(request, tuple(table.folder for table in tables), folder)
    for row in planned:
        if row.skipped is not None:
            say.notice(f"{row.label} ({row.run.condition.value}): skipped, {row.skipped}")
    if plan.limit is None:
        with say.timing() as measuring:
            plan = with_limit(plan, request, tables, planned, engine=engine, measuring=measuring, folder=folder)
    assert plan.limit is not None
    limit = plan.limit
    say.notice(_shown_limit(plan, tables, request.split))
    outcomes = tuple(_outcome(row, limit, engine, say) for row in planned)
    layout = lay_out(outcomes, tables=tables, split=request.split, limit=limit, minutes=plan.minutes)
    write_text(folder / MARKDOWN, as_markdown(layout))
    write_json(folder / JSON, as_builtins(layout))
    return TableReport(folder, layout, outcomes)


def _outcome(planned: PlannedRow, limit: int, engine: Engine, say: Say) -> RowOutcome:
    """Run one row; whatever is wrong with it is put down and said, except that nothing can be written."""
    if planned.skipped is not None:
        return RowOutcome(planned, "skipped", planned.skipped)
    try:
        with say.row(planned) as progress:
            report = run_method(planned.limited(limit), engine=engine, progress=progress)
    except StorageError:
        raise
    except PrbenchError as error:
        reason = str(error)
    except Exception as error:  # a defect of a method, which must not cost the other rows
        reason = f"{type(error).__name__}: {error}"
    else:
        return RowOutcome(planned, "run", folder=report.folder.path)
    say.notice(f"{planned.label} ({planned.run.condition.value}): failed, {reason}")
    return RowOutcome(planned, "failed", reason)


def _shown_limit(plan: TablePlan, tables: list[SequenceTable], split: str) -> str:
    counts = ", ".join(
        f"{table.info.dataset} n = {min(plan.limit or size.sequences, size.sequences)} of {size.sequences}"
        for table, size in ((table, dataset_size(table, split)) for table in tables)
    )
    if plan.minutes is None:
        return f"{counts} (--limit {plan.limit})"
    return f"{counts}: what fits into {plan.minutes} minutes here (--minutes; --limit N says it outright)"
