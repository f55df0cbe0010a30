"""Single rows of a sequence table, found without reading the others."""

from __future__ import annotations

from pathlib import Path

from prbench.boundary import foreign_input
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
    """Read one row; of the file only the group of 256 rows that it stands in is read.

    Args:
        table: The table.
        wanted: The sequence's id, or a beginning, end or part of it that fits one sequence only.

    Returns:
        The row with all columns.

    Raises:
        UsageError: if no sequence fits, or several do.
        TableError: if the file is damaged.
    """
    ids_of_part = {path: _ids(path) for path in table.part_paths("sequences")}
    known = [name for ids in ids_of_part.values() for name in ids]
    name = find_sequence_id(wanted, known, among=table.info.dataset)
    path = next(path for path, ids in ids_of_part.items() if name in ids)
    row = ids_of_part[path].index(name)
    file = open_parquet(path)
    group = 0
    while row >= file.metadata.row_group(group).num_rows:
        row -= file.metadata.row_group(group).num_rows
        group += 1
    with naming(path):
        rows = file.read_row_group(group, columns=SEQUENCES.names)
    return SequenceChunk(rows.slice(row, 1).combine_chunks().to_batches()[0])
