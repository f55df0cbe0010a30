"""Rows of tables in Parquet files: found and streamed; damage is reported with the file's name."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from collections.abc import Sequence as SequenceOf
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from prbench import parquet_files
from prbench.boundary import foreign_input
from prbench.errors import TableError
from prbench.ranges import first_repeated
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
    ids: frozenset[str] | None,
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
    of_split = pa.array([split], type=pa.string())
    known = pa.array(sorted(ids or ()), type=pa.string())
    for path in paths:
        with naming(path):
            for batch in open_parquet(path).iter_batches(batch_size=rows, columns=read):
                if split is not None:
                    batch = _kept(batch, "split", of_split)
                if ids is not None:
                    batch = _kept(batch, "sequence_id", known)
                if batch.num_rows:
                    yield SequenceChunk(batch.select(columns))


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
        return parquet_files.open_parquet(path)


def read_parquet(path: Path, columns: list[str]) -> pa.Table:
    """Some columns of a Parquet file.

    Raises:
        TableError: if it is missing or damaged.
    """
    with naming(path):
        return parquet_files.read_parquet(path, columns)


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


def _kept(batch: pa.RecordBatch, column: str, values: pa.Array) -> pa.RecordBatch:
    """The rows whose ``column`` is one of ``values``; without a copy where these are all."""
    wanted = pc.call_function("is_in", [batch.column(column)], pc.SetLookupOptions(values))
    return batch if wanted.true_count == len(wanted) else batch.filter(wanted)


def is_bulky(kind: pa.DataType) -> bool:
    """Return True if a column holds per-frame values or whole poses."""
    return pa.types.is_list(kind) or (pa.types.is_fixed_size_list(kind) and kind.list_size > 16)
