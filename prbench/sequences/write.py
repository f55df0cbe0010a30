"""Write tables as Parquet (byte-stream split, zstd 1, row groups of 256 rows), and dataset folders as a whole.

Source: docs/specification/sequence-table.md#encoding.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from collections.abc import Sequence as SequenceOf
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.files.storage import atomic_folder, atomic_path, require_replaceable
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.protocol.own_protocol import write_protocol
from prbench.sequences.croissant import write_croissant
from prbench.sequences.dataset_info import FILE_NAME, DatasetInfo
from prbench.sequences.digests import RowDigests, digests_of_files
from prbench.sequences.replacing import Holdings, require_no_loss
from prbench.sequences.schema import DATASET_TABLES, OPTIONAL_TABLES, with_metadata
from prbench.sequences.table import Info, SequenceTable

_ROW_GROUP_ROWS = 256
_LARGEST_PART_BYTES = 512 * 1024**2
_ROWS = {
    "sequences": "One prime-and-reach sequence: from 2 s before the first look at the goal to the pick or put.",
    "events": "One candidate pick or put, with what became of it and the number that decided.",
    "recordings": "One recording that was found, with counts of its events by outcome.",
    "scenes": "The box of one thing that stands still through a recording, such as a piece of furniture.",
}


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
    largest_part: int = _LARGEST_PART_BYTES,
    row_group_rows: int = _ROW_GROUP_ROWS,
) -> int:
    """Write ``folder/name.parquet``, or ``folder/name/part-*.parquet`` where one file would pass ``largest_part``.

    Whichever form an earlier build left is replaced.

    Returns:
        The number of rows.
    """
    single = folder / f"{name}.parquet"
    parts = folder / name
    rows = 0
    count = 1
    schema = with_metadata(schema, protocol_version=protocol_version)
    with atomic_folder(parts) as temporary:
        writer = _PartWriter(temporary / "part-00000.parquet", schema, row_group_rows)
        for batch in batches:
            if writer.bytes_written >= largest_part:
                writer.close()
                writer = _PartWriter(temporary / f"part-{count:05d}.parquet", schema, row_group_rows)
                count += 1
            rows += writer.append(batch)
        writer.close()
    if count == 1:
        (parts / "part-00000.parquet").replace(single)
        parts.rmdir()
    else:
        single.unlink(missing_ok=True)
    return rows


class _PartWriter:
    """One Parquet file, filled in row groups of a fixed number of rows whatever the size of the batches."""

    def __init__(self, path: Path, schema: pa.Schema, row_group_rows: int = _ROW_GROUP_ROWS) -> None:
        self._schema = schema
        self._row_group_rows = row_group_rows
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
        """Take up rows; complete row groups go to the file. Return the number of rows."""
        self._pending.append(batch)
        self._pending_rows += batch.num_rows
        if self._pending_rows >= self._row_group_rows:
            self._flush(everything=False)
        return batch.num_rows

    def close(self) -> None:
        """Write what is pending and the footer."""
        self._flush(everything=True)
        self._writer.close()
        self._file.close()

    def _flush(self, *, everything: bool) -> None:
        table = pa.Table.from_batches([batch.cast(self._schema) for batch in self._pending], self._schema)
        # Whole row groups only, so that the file does not depend on how rows came in batches.
        rows = table.num_rows if everything else table.num_rows - table.num_rows % self._row_group_rows
        if rows:
            self._writer.write_table(table.slice(0, rows), row_group_size=self._row_group_rows)
        self._pending = table.slice(rows).to_batches()
        self._pending_rows = table.num_rows - rows


def _leaves(schema: pa.Schema, *, floating: bool) -> list[str]:
    """Parquet names of the leaf columns that hold floats, or of all the others."""
    leaves = [leaf for field in schema for leaf in _leaf_paths(field.name, field.type)]
    return [path for path, kind in leaves if pa.types.is_floating(kind) is floating]


def _leaf_paths(path: str, kind: pa.DataType) -> list[tuple[str, pa.DataType]]:
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        return _leaf_paths(f"{path}.list.element", kind.value_type)
    if pa.types.is_struct(kind):
        return [leaf for field in kind for leaf in _leaf_paths(f"{path}.{field.name}", field.type)]
    return [(path, kind)]


def write_dataset(
    folder: Path,
    info: DatasetInfo,
    *,
    sequences: Iterable[pa.RecordBatch],
    events: Iterable[pa.RecordBatch],
    recordings: Iterable[pa.RecordBatch],
    scenes: Iterable[pa.RecordBatch] = (),
    replace: bool = False,
    incomplete: Collection[str] = (),
    protocol: BenchmarkProtocol | None = None,
) -> DatasetInfo:
    """Write the folder whole or not at all; a dataset that was there is replaced, anything else is not touched.

    Args:
        folder: The dataset folder.
        info: Provenance; its digests are filled in here.
        sequences: Rows in table order (sorted by ``sequence_id``).
        events: Rows of ``events``.
        recordings: Rows of ``recordings``.
        scenes: Rows of ``scenes``; without any there is no such file.
        replace: Replace a dataset that holds recordings which this one lacks.
        incomplete: Ids of recordings of which a part could not be read, or a file ends early.
        protocol: Rules by which it was curated; a copy of a user's own ones is written beside the tables.

    Returns:
        The provenance as written.

    Raises:
        StorageError: if the folder holds something that is no dataset, or cannot be written.
        RecordingsWouldBeLost: if the dataset that was there holds more, and ``replace`` is not set.
    """
    require_replaceable(folder, FILE_NAME, kind="dataset")
    recordings = list(recordings)
    if not replace:
        new = Holdings.of(recordings, "sequence")
        require_no_loss(folder, FILE_NAME, new, outcome="sequence", what="sequences", incomplete=incomplete)
    tables = {"sequences": sequences, "events": events, "recordings": recordings}
    schemas = dict(DATASET_TABLES)
    boxes = [batch for batch in scenes if batch.num_rows]
    if boxes:
        tables["scenes"] = boxes
        schemas |= OPTIONAL_TABLES
    with atomic_folder(folder) as temporary:
        info = write_tables(temporary, info, tables, schemas, SequenceTable.identity_columns)
        write_croissant(temporary, info, schemas, _ROWS)
        if protocol is not None:
            write_protocol(temporary, protocol)
    return info


def write_tables(
    folder: Path,
    info: Info,
    tables: Mapping[str, Iterable[pa.RecordBatch]],
    schemas: Mapping[str, pa.Schema],
    identity_columns: SequenceOf[str],
    *,
    row_group_rows: int = _ROW_GROUP_ROWS,
) -> Info:
    """Write the tables of a dataset or corpus, then its description, which holds their digests.

    Args:
        folder: An empty folder.
        info: Provenance; its digests are filled in here.
        tables: Rows of every table by its name.
        schemas: Columns of every table; the first one holds the motions, and may be written in parts.
        identity_columns: Columns of the first table that make its identity.
        row_group_rows: Rows of the first table that are written, and later read, together.

    Returns:
        The provenance as written.
    """
    version = info.protocol_version
    main, *others = schemas
    # Digests are taken while the rows pass to the file: a table is never read back for them.
    digests = RowDigests(schemas[main].names, identity_columns)
    rows = digests.pass_on(tables[main])
    write_table_in_parts(folder, main, rows, schemas[main], protocol_version=version, row_group_rows=row_group_rows)
    for name in others:
        write_table(folder / f"{name}.parquet", tables[name], schemas[name], protocol_version=version)
    info = msgspec.structs.replace(
        info,
        identity_digest=digests.identity(version),
        content_digest=digests.content.hexdigest(),
        file_digests=digests_of_files(folder, schemas),
    )
    info.write(folder)
    return info
