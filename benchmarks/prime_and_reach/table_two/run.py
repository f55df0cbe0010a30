"""Work through the rows of Table 2, unattended.

``plan.json`` says what was asked for; every row is a run folder of its own, which resumes. A row that cannot be run is
skipped with a reason, when one fails, the others go on, and the next call tries it again.
After a kill at any moment the same request goes on and ends with the same numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import msgspec

from prbench.board import collect_runs, make_leaderboard
from prbench.board.tables import Leaderboard, of_all_methods
from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, RunError, StorageError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import remove_leftovers, require_replaceable, sole_writer, write_json
from prbench.harness.planning import select
from prbench.harness.request import ProgressCallback, silent
from prbench.harness.results import CheckedSummary, RunChecker
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder, TableRecord
from prbench.tables import Table, write_tables
from prbench_benchmarks.prime_and_reach.study.methods import methods_table
from prbench_benchmarks.prime_and_reach.table_two.request import PlannedRow, TableRequest, plan_rows

PLAN = "plan.json"
MARKDOWN = "table_2.md"
JSON = "table_2.json"


class TableReport(msgspec.Struct, frozen=True, kw_only=True):
    """Table 2 on one's own tables (``--method all``), once it is through.

    Attributes:
        folder: Folder of the rows' run folders and of the two files of the table.
        failed: Maps rows that were to be run and have no numbers to the reason.
        tables: The content of ``table_2.json``: a part for each dataset; a table of notes alone where no row has
            numbers.
    """

    folder: Path
    failed: dict[str, str]
    tables: list[Table]


def run_table(
    request: TableRequest,
    *,
    engine: Engine | None = None,
    notice: Callable[[str], None] = lambda _: None,
    progress: Callable[[PlannedRow], AbstractContextManager[ProgressCallback]] = lambda _: nullcontext(silent),
) -> TableReport:
    """Run what is missing of a table and lay it out; also written as ``table_2.md`` and ``table_2.json``.

    Args:
        request: What to run on what.
        engine: Engine that generates and scores batches; this process by default.
        notice: Called with each line that stays: what is skipped, what has failed, how many sequences there are.
        progress: Shows the progress of one row.

    Raises:
        AdapterError: if a method refuses its options.
        RunError: if the folder belongs to another request.
        StorageError: if a file cannot be written, or another process is working on the folder.
        TableError: if a table is missing, empty, changed or of an unknown version.
        UsageError: if the request does not fit together.
    """
    tables = request.tables()
    folder = request.folder()
    whole = {table.info.dataset: len(select(table, split=request.split, limit=None)) for table in tables}
    planned = plan_rows(request, tuple(table.folder for table in tables), folder)
    notes = []
    finished = []
    failed = {}
    with sole_writer(folder):
        _require_same(folder, request.deciding(tables))
        counts = (f"{name} n = {min(request.limit, count)} of {count}" for name, count in whole.items())
        notice(f"{', '.join(counts)} (--limit {request.limit})")
        for row in planned:
            about = f"{row.label} ({row.condition.value})"
            reason = row.skipped
            if reason is None:
                try:
                    with progress(row) as show:
                        report = run_method(row.run, engine=engine or InProcess(), progress=show)
                    finished.append(report.folder.path)
                    continue
                except StorageError:  # if nothing can be written all of the table ends
                    raise
                except Exception as error:  # a defect of a method, which must not cost the other rows
                    reason = str(error) if isinstance(error, PrbenchError) else f"{type(error).__name__}: {error}"
                failed[row.name] = reason
            notes.append(f"{about}: {'failed' if row.skipped is None else 'skipped'}, {reason}")
            notice(notes[-1])
        parts = [Table(number="2", title="nothing could be run", notes=tuple(notes))]
        if finished:

            def check(run: RunFolder, table: TableRecord) -> CheckedSummary:
                """Take scores that this very call has made or held against the motions."""
                return replace(RunChecker().check(run, table), unverified="")

            board = make_leaderboard(collect_runs(finished, check=check))
            # A table of the common sequences takes the place of that of all: one line, one set of sequences.
            board = Leaderboard(of_all_methods(board.tables), board.macro, board.notes)
            parts = methods_table(board, "2", with_published=False, named=True)
            parts[-1] = msgspec.structs.replace(parts[-1], notes=(*parts[-1].notes, *notes))
        for name in (MARKDOWN, JSON):
            remove_leftovers(folder / name)  # of a process that was killed while it wrote them
            write_tables(parts, folder / name)  # last, after all rows: a table on disk is a finished one
    return TableReport(folder=folder, failed=failed, tables=parts)


@foreign_input()
def _require_same(folder: Path, asked: Mapping[str, str]) -> None:
    """Write what is asked for into a new folder; refuse a folder of another request.

    Raises:
        RunError: if the folder belongs to another request, or the file is damaged.
        StorageError: if the folder holds something else.
    """
    path = folder / PLAN
    # A process that was killed while it wrote the plan has left a temporary file, which must not make the folder look
    # used.
    remove_leftovers(path)
    require_replaceable(folder, PLAN, kind="folder of a table")
    if not path.is_file():
        write_json(path, dict(asked))
        return
    try:
        found = msgspec.json.decode(read_whole(path), type=dict[str, str])
    except msgspec.DecodeError as error:
        raise RunError(f"{path}: not a valid {PLAN}: {error}. Choose another folder for --out.") from error
    differences = []
    for key in dict.fromkeys([*asked, *found]):
        was = found.get(key)
        now = asked.get(key)
        if was == now:
            continue
        if not key.startswith("table "):
            differences.append(f"{key} was {was or 'not given'}, now is {now or 'not given'}")
        elif was is not None and now is not None:
            differences.append(f"{key} has other contents now")
        else:
            differences.append(f"{key} is {'new' if was is None else 'missing'}")
    if differences:
        remedy = "Choose another folder for --out, or delete this one."
        raise RunError(f"{path}: the folder holds another table: {'; '.join(differences)}. {remedy}")
