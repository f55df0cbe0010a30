"""Parquet files, opened without trust: what their metadata declares is looked at before a row is unpacked.

A few bytes of a Parquet file can stand for billions of equal values, so its size on the disk says nothing.
"""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from prbench.files.bounded import require_size
from prbench.limits import LARGEST_ARCHIVE, LARGEST_HEADER, MOST_ROWS, MOST_VALUES, MOST_VALUES_PER_BYTE


def open_parquet(path: Path, *, verify: bool = False) -> pq.ParquetFile:
    """A Parquet file whose metadata declares no more than a table or a run can hold.

    Args:
        path: The file.
        verify: Compare the checksum of every page that is read.

    Raises:
        InputFileError: if it is a folder, a pipe or a device.
        pa.ArrowInvalid: if it is no Parquet file, or declares too much.
        OSError: if it is missing or cannot be read.
    """
    require_size(path, largest=LARGEST_ARCHIVE)
    file = pq.ParquetFile(
        path,
        page_checksum_verification=verify,
        thrift_string_size_limit=LARGEST_HEADER,
        # Reading ahead keeps every row group that was streamed in memory until the file is closed.
        pre_buffer=False,
    )
    excess = _excess(file.metadata)
    if excess:
        raise pa.ArrowInvalid(excess)
    return file


def read_parquet(path: Path, columns: list[str] | None = None, *, verify: bool = False) -> pa.Table:
    """Some columns of a Parquet file, all by default (see :func:`open_parquet` for what it raises)."""
    file = open_parquet(path, verify=verify)
    missing = [name for name in columns or () if name not in file.schema_arrow.names]
    if missing:
        raise pa.ArrowInvalid(f"no column '{missing[0]}'")
    return file.read(columns)


def _excess(metadata: pq.FileMetaData) -> str:
    """Say in a few words what a file declares too much of; empty if nothing."""
    if metadata.num_rows > MOST_ROWS:
        return f"{metadata.num_rows:,} rows declared, expected at most {MOST_ROWS:,}"
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for place in range(group.num_columns):
            column = group.column(place)
            plausible = max(MOST_VALUES, MOST_VALUES_PER_BYTE * column.total_compressed_size)
            if column.num_values > plausible:
                return (
                    f"{column.num_values:,} values of '{column.path_in_schema}' declared in row group {number},"
                    f" expected at most {plausible:,} in {column.total_compressed_size:,} bytes"
                )
    return ""
