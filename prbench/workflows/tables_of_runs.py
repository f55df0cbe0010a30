"""Find the table that a run was made on: a run folder holds digests only, no paths."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from prbench.errors import RunError, TableError, UsageError
from prbench.runs import RunFolder
from prbench.runs.record import TableRecord
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.workflows.first_run import default_table_folder

_SHOWN = 12  # characters of a digest


def tables_of_runs(runs: Sequence[RunFolder], data: Sequence[Path]) -> list[SequenceTable]:
    """The tables that all runs have in common, in the order of the first run.

    Args:
        runs: One or more.
        data: Dataset folders; where none is given, the tables in prbench's own cache are tried by digest.

    Raises:
        TableError: if no table was named and none in the cache is the one.
        RunError: if a named table is another one than a run's; names both digests.
        UsageError: if the runs have no dataset in common.
    """
    shared = set.intersection(*(_datasets(run) for run in runs))
    common = [record for record in runs[0].record.tables if record.dataset in shared]
    if not common:
        raise UsageError("these runs have no dataset in common, so that nothing can stand beside one another.")
    named = [SequenceTable.open(folder).with_sequences() for folder in data]
    if not named:
        tables = [_from_cache(runs[0], record) for record in common]
    else:
        tables = [table for table in named if table.info.dataset in shared]
        if not tables:
            raise RunError(
                f"{runs[0].path}: the run is of {', '.join(record.dataset for record in common)}; --data names"
                f" {', '.join(table.info.dataset for table in named)}. Name the table that it was made on."
            )
    for run in runs:
        for table in tables:
            _require_table_of(run, table)
    return tables


def _datasets(run: RunFolder) -> set[str]:
    return {table.dataset for table in run.record.tables}


def table_finder(data: Sequence[Path]) -> Callable[[TableRecord], SequenceTable | None]:
    """A function that finds the table of a run among the named ones and those in prbench's own cache.

    Raises:
        TableError: if a named one cannot be opened; the function raises it for one in the cache.
    """
    opened = [SequenceTable.open(folder) for folder in data]

    def find(record: TableRecord) -> SequenceTable | None:
        for table in opened:
            if _is_table_of(record, table):
                return table
        for folder in _embedded():
            if DatasetInfo.read(folder).content_digest == record.content_digest:
                opened.append(SequenceTable.open(folder))
                return opened[-1]
        return None

    return find


def _embedded() -> Iterator[Path]:
    """Folders of the embedded default table, and of other ones that an earlier version left beside it."""
    default = default_table_folder()
    # The table of the present version first: nearly every run was made on it.
    for folder in dict.fromkeys([default, *sorted(path.parent for path in default.parent.glob("*/dataset.json"))]):
        if (folder / "dataset.json").is_file():
            yield folder


def _require_table_of(run: RunFolder, table: SequenceTable) -> None:
    record = next(record for record in run.record.tables if record.dataset == table.info.dataset)
    if not _is_table_of(record, table):
        raise RunError(
            f"{table.folder}: expected the table that {run.path} was made on (content digest"
            f" {record.content_digest[:_SHOWN]}…), found another one ({table.info.content_digest[:_SHOWN]}…)."
            " Name that table with --data DIR, or run the method again on this one."
        )


def _is_table_of(record: TableRecord, table: SequenceTable) -> bool:
    # Identity says which sequences, content says which numbers; a rebuilt table may share only the first.
    return (record.identity_digest, record.content_digest) == (table.identity, table.info.content_digest)


def _from_cache(run: RunFolder, record: TableRecord) -> SequenceTable:
    """The embedded default table, or another one that an earlier version left beside it."""
    for folder in _embedded():
        table = SequenceTable.open(folder)
        if table.info.dataset == record.dataset and _is_table_of(record, table):
            return table
    raise TableError(
        f"{run.path}: was made on a table of {record.dataset} with content digest {record.content_digest[:_SHOWN]}…,"
        " which is not among the embedded ones. Name its folder with --data DIR."
    )
