"""Single rows of a sequence table, found without reading the others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from prbench.files.boundary import foreign_input
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.sequences.rows import naming, open_parquet, read_parquet
from prbench.sequences.schema import SEQUENCES
from prbench.sequences.table import find_sequence_id


def sequence_ids(table: SequenceTable) -> list[str]:
    """Return the ids of all sequences in table order.

    Args:
        table: The table.
    """
    return [name for path in table.part_paths("sequences") for name in _ids(path)]


def _ids(path: Path) -> list[str]:
    return read_parquet(path, ["sequence_id"])["sequence_id"].to_pylist()


@foreign_input()
def read_row(table: SequenceTable, wanted: str) -> SequenceChunk:
    """Read one row; of the files only the footers and the group of 256 rows that it stands in are read.

    Where no sequence has the very id that was given, the ids of all are read to find the one that is meant.

    Args:
        table: The table.
        wanted: The sequence's id, or a beginning, end or part of it that fits one sequence only.

    Returns:
        The row with all columns.

    Raises:
        UsageError: if no sequence fits, or several do.
        TableError: if the file is damaged.
    """
    found = next(_rows_of(table, wanted), None)
    if found is None:
        name = find_sequence_id(wanted, sequence_ids(table), among=table.info.dataset)
        found = next(_rows_of(table, name))
    return found


def holds(table: SequenceTable, sequence_id: str) -> bool:
    """Return True if a sequence has this very id; of the files only the groups of rows that may hold it are read."""
    return any(table.chunks(columns=["sequence_id"], ids=frozenset({sequence_id})))


def row_count(table: SequenceTable) -> int:
    """Return the number of sequences, as the footers tell it."""
    return sum(open_parquet(path).metadata.num_rows for path in table.part_paths("sequences"))


@foreign_input()
def read_place(table: SequenceTable, place: int) -> SequenceChunk:
    """Read the row at a place, counted from 0; of the files only its group of rows is read.

    Args:
        table: The table.
        place: Below :func:`row_count`.

    Raises:
        TableError: if the file is damaged.
    """
    for path in table.part_paths("sequences"):
        file = open_parquet(path)
        for number in range(file.num_row_groups):
            rows = file.metadata.row_group(number).num_rows
            if place < rows:
                with naming(path):
                    group = file.read_row_group(number, columns=SEQUENCES.names)
                return SequenceChunk(group.slice(place, 1).combine_chunks().to_batches()[0])
            place -= rows
    raise IndexError("a place beyond the last row")


def _rows_of(table: SequenceTable, sequence_id: str) -> Iterator[SequenceChunk]:
    return table.chunks(ids=frozenset({sequence_id}))
