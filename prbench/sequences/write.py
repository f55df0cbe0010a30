"""Write tables as Parquet: byte-stream split, zstd 1, row groups of 256 rows.

Source: docs/specification/sequence-table.md#encoding.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from prbench.sequences.schema import with_metadata
from prbench.storage import atomic_folder, atomic_path

ROW_GROUP_ROWS = 256
LARGEST_PART_BYTES = 512 * 1024**2


def write_table(path: Path, batches: Iterable[pa.RecordBatch], schema: pa.Schema, *, protocol_version: int) -> int:
    """Write batches as one Parquet file, whole or not at all.

    Returns:
        The number of rows.
    """
    with atomic_path(path) as temporary:
        writer = _PartWriter(temporary, with_metadata(schema, protocol_version=protocol_version))
        rows = sum(writer.append(batch) for batch in batches)
        writer.close()
    return rows


def write_table_in_parts(
    folder: Path,
    name: str,
    batches: Iterable[pa.RecordBatch],
    schema: pa.Schema,
    *,
    protocol_version: int,
    largest_part: int = LARGEST_PART_BYTES,
) -> int:
    """Write ``folder/name.parquet``, or ``folder/name/part-*.parquet`` where one file would pass ``largest_part``.

    Whichever form an earlier build left is replaced.

    Returns:
        The number of rows.
    """
    single, parts = folder / f"{name}.parquet", folder / name
    rows = 0
    with atomic_folder(parts) as temporary:
        writers: list[_PartWriter] = []
        for batch in batches:
            if not writers or writers[-1].bytes_written >= largest_part:
                if writers:
                    writers[-1].close()
                part = temporary / f"part-{len(writers):05d}.parquet"
                writers.append(_PartWriter(part, with_metadata(schema, protocol_version=protocol_version)))
            rows += writers[-1].append(batch)
        if not writers:
            part = temporary / "part-00000.parquet"
            writers.append(_PartWriter(part, with_metadata(schema, protocol_version=protocol_version)))
        writers[-1].close()
    if len(writers) == 1:
        (parts / "part-00000.parquet").replace(single)
        parts.rmdir()
    else:
        single.unlink(missing_ok=True)
    return rows


class _PartWriter:
    """One Parquet file, filled in row groups of a fixed number of rows whatever the size of the batches."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self._schema = schema
        self._pending: list[pa.RecordBatch] = []
        self._pending_rows = 0
        self._file = open(path, "wb")  # noqa: SIM115 - closed in close()
        self._writer = pq.ParquetWriter(
            self._file,
            schema,
            compression="zstd",
            compression_level=1,
            use_dictionary=_leaves(schema, floating=False),  # type: ignore[arg-type] - the stub knows bool only
            column_encoding=dict.fromkeys(_leaves(schema, floating=True), "BYTE_STREAM_SPLIT"),
            write_statistics=_leaves(schema, floating=False),  # type: ignore[arg-type]
            write_page_checksum=True,
        )

    @property
    def bytes_written(self) -> int:
        """Bytes in the file so far, whole row groups only."""
        return self._file.tell()

    def append(self, batch: pa.RecordBatch) -> int:
        """Take up rows; complete row groups go to the file."""
        self._pending.append(batch)
        self._pending_rows += batch.num_rows
        if self._pending_rows >= ROW_GROUP_ROWS:
            self._flush(everything=False)
        return batch.num_rows

    def close(self) -> None:
        """Write what is pending and the footer."""
        self._flush(everything=True)
        self._writer.close()
        self._file.close()

    def _flush(self, *, everything: bool) -> None:
        table = pa.Table.from_batches([batch.cast(self._schema) for batch in self._pending], self._schema)
        rows = table.num_rows if everything else table.num_rows - table.num_rows % ROW_GROUP_ROWS
        if rows:
            self._writer.write_table(table.slice(0, rows), row_group_size=ROW_GROUP_ROWS)
        self._pending = table.slice(rows).to_batches()
        self._pending_rows = table.num_rows - rows


def _leaves(schema: pa.Schema, *, floating: bool) -> list[str]:
    """Parquet names of the leaf columns that hold floats, or of all the others."""
    return [
        path for field in schema for path, kind in _leaf_paths(field.name, field.type) if _is_float(kind) is floating
    ]


def _leaf_paths(path: str, kind: pa.DataType) -> list[tuple[str, pa.DataType]]:
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        return _leaf_paths(f"{path}.list.element", kind.value_type)
    if pa.types.is_struct(kind):
        return [leaf for field in kind for leaf in _leaf_paths(f"{path}.{field.name}", field.type)]
    return [(path, kind)]


def _is_float(kind: pa.DataType) -> bool:
    return pa.types.is_floating(kind)
