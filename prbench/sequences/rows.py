"""Rows of tables in Parquet files: found and streamed; damage is reported with the file's name."""

from __future__ import annotations

import contextlib
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from prbench.errors import TableError
from prbench.files import arrays
from prbench.files.arrays import first_repeated
from prbench.files.bounded import foreign_input
from prbench.sequences.chunk import SequenceChunk
from prbench.sequences.digests import files_of_table
from prbench.shown import quoted


def table_parts(folder: Path, name: str) -> list[Path]:
    """The Parquet files of one table: a single file, or the parts of a folder in order.

    Raises:
        TableError: if neither exists.
    """
    found = files_of_table(folder, name)
    if not found:
        raise TableError(f"{folder}: expected {name}.parquet or {name}/part-*.parquet, found neither.")
    return found


def stream_chunks(
    paths: SequenceOf[Path],
    columns: list[str],
    *,
    split: str | None,
    ids: Collection[str] | None,
    rows: int,
) -> Iterator[SequenceChunk]:
    """Stream rows of Parquet files in order.

    Args:
        paths: The parts of one table.
        columns: What the chunks hold.
        split: Only this split; all if None.
        ids: Only the rows with these ``sequence_id``; all if None.
        rows: Largest number of rows read at once.
    """
    needed = [name for name, chosen in (("split", split), ("sequence_id", ids)) if chosen is not None]
    read = list(dict.fromkeys([*columns, *needed]))
    wanted: dict[str, list[str]] = {}
    if split is not None:
        wanted["split"] = [split]
    ordered = sorted(ids or ())
    if ids is not None:
        wanted["sequence_id"] = ordered
    for path in paths:
        with naming(path):
            file = open_parquet(path)
            groups = groups_that_may_hold(file.metadata, wanted)
            for batch in file.iter_batches(batch_size=rows, row_groups=groups, columns=read):
                if split is not None:
                    batch = _kept(batch, pc.call_function("equal", [batch.column("split"), pa.scalar(split)]))
                if ids is not None and batch.num_rows:
                    names = batch.column("sequence_id").to_pylist()
                    # Not Arrow's is_in, which builds its table of all ids anew for every batch.
                    near = set(ordered[bisect_left(ordered, min(names)) : bisect_right(ordered, max(names))])
                    batch = _kept(batch, pa.array([name in near for name in names]))
                if batch.num_rows:
                    yield SequenceChunk(batch.select(columns))


def groups_that_may_hold(metadata: pq.FileMetaData, wanted: Mapping[str, SequenceOf[str]]) -> list[int]:
    """Return the numbers of the row groups that may hold wanted rows, as the footer of a Parquet file tells.

    Args:
        metadata: The footer. It holds the smallest and the largest text of each column of every row group.
        wanted: Maps names of text columns to sorted values; a row is wanted if it has one of them in each column.
    """
    if not metadata.num_row_groups:
        return []
    first = metadata.row_group(0)
    # Not from `metadata.schema`: pyarrow then never frees the footer (a cycle that no collector sees).
    paths = [first.column(place).path_in_schema for place in range(metadata.num_columns)]
    places = {paths.index(name): values for name, values in wanted.items() if name in paths}
    return [
        number
        for number in range(metadata.num_row_groups)
        if all(_may_hold(metadata.row_group(number).column(place), values) for place, values in places.items())
    ]


def _may_hold(column: pq.ColumnChunkMetaData, values: SequenceOf[str]) -> bool:
    """Return False where no value lies between the smallest and the largest text; a file may lack these."""
    statistics = column.statistics
    if statistics is None or not statistics.has_min_max or not isinstance(statistics.min, str):
        return True
    place = bisect_left(values, statistics.min)
    return place < len(values) and values[place] <= statistics.max


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into an error that names it; bytes may be damaged anywhere."""
    with foreign_input(path):
        try:
            yield
        except FileNotFoundError as error:
            raise TableError(f"{path}: expected a Parquet file, found none.") from error
        except (pa.ArrowException, OSError) as error:
            # MemoryError of Arrow is an ArrowException too, and the file is not to blame for it.
            if isinstance(error, MemoryError):
                raise
            first = str(error).splitlines()[0] if str(error) else "damaged"
            raise TableError(f"{path}: not a readable Parquet file ({first}). Build the dataset again.") from error


def open_parquet(path: Path) -> pq.ParquetFile:
    """A Parquet file, opened.

    Raises:
        TableError: if it is missing or damaged.
    """
    with naming(path):
        return arrays.open_parquet(path)


def read_parquet(path: Path, columns: list[str]) -> pa.Table:
    """Some columns of a Parquet file.

    Raises:
        TableError: if it is missing or damaged.
    """
    with naming(path):
        return arrays.read_parquet(path, columns)


def require_distinct(ids: SequenceOf[str], where: Path | str) -> None:
    """Refuse rows of one id: which of them is meant would depend on their order, and counts would count them twice.

    Raises:
        TableError: naming the first repeated id.
    """
    repeated = first_repeated(ids)
    if repeated is not None:
        raise TableError(
            f"{where}: expected rows with different ids, found '{quoted(repeated)}' twice. Build the dataset again."
        )


def require_distinct_rows(paths: SequenceOf[Path], column: str, where: Path | str) -> None:
    """Refuse rows of one id in a column of Parquet files; sorted rows are looked at a batch at a time.

    Raises:
        TableError: naming the first repeated id, or the file that is missing or damaged.
    """
    last = ""
    for name in _texts(paths, column):
        if name <= last:  # not sorted, so that any two rows have to be compared
            require_distinct(list(_texts(paths, column)), where)
            return
        last = name


def _texts(paths: SequenceOf[Path], column: str) -> Iterator[str]:
    for path in paths:
        with naming(path):
            for batch in open_parquet(path).iter_batches(batch_size=1024, columns=[column]):
                yield from batch.column(0).to_pylist()


def _kept(batch: pa.RecordBatch, wanted: pa.BooleanArray) -> pa.RecordBatch:
    """The wanted rows; without a copy where these are all."""
    return batch if wanted.true_count == len(wanted) else batch.filter(wanted)


def is_bulky(kind: pa.DataType) -> bool:
    """Return True if a column holds per-frame values or whole poses."""
    return pa.types.is_list(kind) or (pa.types.is_fixed_size_list(kind) and kind.list_size > 16)
