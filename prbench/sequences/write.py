"""Write tables as Parquet (byte-stream split, zstd 1, row groups of 256 rows), and dataset folders as a whole.

Source: docs/specification/sequence-table.md#encoding.

Beside the tables stands ``croissant.json``: what a built dataset is, in the words that dataset search engines and
loaders understand. It is JSON-LD of the Croissant vocabulary 1.1 (https://docs.mlcommons.org/croissant/), whose terms
``croissant_context.json`` holds; one record set a table, one field a column. It holds no time of day, host or path.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.errors import InputFileError, RecordingsWouldBeLost, TableError
from prbench.files.storage import atomic_folder, atomic_path, file_digest, read_json, require_replaceable, write_json
from prbench.protocol.manifests import BenchmarkProtocol
from prbench.protocol.own_protocol import write_protocol
from prbench.sequences import schema as table_schema
from prbench.sequences.dataset_info import FILE_NAME, DatasetInfo
from prbench.sequences.sequence import KEY_VALUES
from prbench.sequences.table import Info, SequenceTable
from prbench.shown import clean, quoted

Batches = Iterable[pa.RecordBatch]
_CROISSANT = "croissant.json"
_PARQUET = "application/x-parquet"


def write_croissant(
    folder: Path, info: DatasetInfo, tables: dict[str, pa.Schema], descriptions: dict[str, str]
) -> None:
    """Write ``croissant.json`` beside tables that are complete.

    Args:
        folder: Holds each table as ``<name>.parquet`` or as a folder ``<name>`` of parts.
        info: Provenance with its digests.
        tables: Columns of each table by its name.
        descriptions: What a row of each table is.
    """
    distribution: list[dict[str, Any]] = []
    record_sets = []
    for name, schema in tables.items():
        entries = []
        for path in table_schema.files_of_table(folder, name):
            place = path.relative_to(folder).as_posix()
            entry = {
                "@type": "cr:FileObject",
                **dict.fromkeys(("@id", "name", "contentUrl"), place),
                "contentSize": f"{path.stat().st_size} B",
                "encodingFormat": _PARQUET,
                "sha256": file_digest(path),
            }
            entries.append(entry)
        distribution += entries
        source: dict[str, Any] = {"fileObject": {"@id": f"{name}.parquet"}}
        if not (folder / f"{name}.parquet").is_file():  # the table's own name is its record set's
            source = {"fileSet": {"@id": f"{name}-parts"}}
            part_set = {
                "@type": "cr:FileSet",
                **dict.fromkeys(("@id", "name"), f"{name}-parts"),
                "encodingFormat": _PARQUET,
                "includes": f"{name}/part-*.parquet",
                "containedIn": [{"@id": entry["@id"]} for entry in entries],
            }
            distribution.append(part_set)
        record_set = {
            "@type": "cr:RecordSet",
            **dict.fromkeys(("@id", "name"), name),
            "description": descriptions[name],
            "key": {"@id": f"{name}/{schema.names[0]}"},
            "field": [_field(name, column, source | {"extract": {"column": column.name}}) for column in schema],
        }
        record_sets.append(record_set)
    document = {
        "@context": json.loads(files("prbench.sequences").joinpath("croissant_context.json").read_text("utf-8")),
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": f"{info.dataset}-prime-and-reach",
        "description": (
            f"{info.title}: {info.counts.sequences} prime-and-reach sequences built by prbench {info.prbench_version},"
            f" protocol {info.protocol_version}. Identity digest {info.identity_digest}."
        ),
        "version": f"{info.schema_version}.{info.protocol_version}.0",
        "license": info.licence,
        "conditionsOfAccess": f"redistribution: {info.redistribution}",
        "isLiveDataset": False,
        "distribution": distribution,
        "recordSet": record_sets,
    }
    told = {"url": info.homepage, "citeAs": info.citation}
    write_json(folder / _CROISSANT, document | {key: text for key, text in told.items() if text})


def _field(table: str, column: pa.Field, source: dict[str, Any]) -> dict[str, Any]:
    described: dict[str, Any] = {
        "@type": "cr:Field",
        "@id": f"{table}/{column.name}",
        "name": column.name,
        "description": column.metadata[b"description"].decode(),
        "unitText": column.metadata[b"unit"].decode(),
    }
    if column.type == KEY_VALUES:
        pair = [
            {
                "@type": "cr:Field",
                "@id": f"{described['@id']}/{part}",
                "name": part,
                "dataType": "sc:Text",
                "source": source | {"transform": {"jsonPath": f"$[*].{part}"}},
            }
            for part in ("key", "value")
        ]
        return described | {"isArray": True, "arrayShape": "-1", "subField": pair}
    # Lists nest: frames of poses are a list of fixed-size lists.
    shape = []
    kind = column.type
    while pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        shape.append(str(kind.list_size) if pa.types.is_fixed_size_list(kind) else "-1")
        kind = kind.value_type
    named = {pa.types.is_floating: "sc:Float", pa.types.is_boolean: "sc:Boolean", pa.types.is_integer: "sc:Integer"}
    described["dataType"] = next((name for is_kind, name in named.items() if is_kind(kind)), "sc:Text")
    described["source"] = source
    return described | ({"isArray": True, "arrayShape": ",".join(shape)} if shape else {})


# Lost recordings that the message names.
_SHOWN = 3
# Characters of the reason of one.
_LONGEST_REASON = 160


def _held(recordings: Batches, outcome: str) -> tuple[dict[str, int], dict[str, str]]:
    """Return the sequences (of a corpus: clips) of every recording that was read, and why others were left out."""
    yields: dict[str, int] = {}
    reasons: dict[str, str] = {}
    for batch in recordings:
        for row in batch.select(["recording_id", "status", "message", outcome]).to_pylist():
            if row["status"] == "read":
                yields[row["recording_id"]] = row[outcome]
            else:
                reasons[row["recording_id"]] = f"{row['status']}: {row['message']}"
    return yields, reasons


def require_no_loss(
    folder: Path, marker: str, recordings: Batches, *, outcome: str, what: str, incomplete: Collection[str] = ()
) -> None:
    """Refuse to replace what stands in a folder by something that holds less.

    Less is: a recording that was read is missing or could not be read; one of which a part could not be read, or a file
    now ends early, yields fewer sequences; or there are no sequences any more. A folder whose recordings cannot be
    listed is replaced by one in which every recording could be read.

    Args:
        folder: Folder in which the new one would stand.
        marker: Name of the file that describes what stands there.
        recordings: Rows of ``recordings`` of the new one.
        outcome: Column of ``recordings`` that counts its sequences or clips.
        what: What these are called.
        incomplete: Recordings of the new one of which a part could not be read, or a file ends early.

    Raises:
        RecordingsWouldBeLost: counting both, and naming the first recordings that would be lost.
    """
    if not (folder / marker).is_file():
        return
    new, reasons = _held(recordings, outcome)
    holds = f"{len(new)} with {sum(new.values())}"
    try:
        columns = ["recording_id", "status", "message", outcome]
        tables = [table_schema.read_parquet(path, columns) for path in table_schema.table_parts(folder, "recordings")]
    except TableError:
        # What cannot be listed cannot be compared. A complete build mends it, as long as that does not go wrong itself.
        before = 0
        with contextlib.suppress(InputFileError, KeyError, msgspec.ValidationError):
            described = msgspec.convert(read_json(folder / marker), dict)  # of any version
            before = msgspec.convert(described["counts"], dict[str, int]).get("recordings_read", 0)
        failed = any(reason.startswith("failed") for reason in reasons.values())
        if new and not failed and len(new) >= before:
            return
        lost = reasons
        counts = f"its recordings cannot be listed (by {marker} {before or 'an unknown number of'} were read),"
        counts += f" and the new one holds {holds} {what}"
    else:
        old, _ = _held(pa.concat_tables(tables).to_batches(), outcome)
        lost = {name: reasons.get(name, "not found") for name in old if name not in new}
        for name in sorted(set(incomplete) & old.keys() & new.keys()):
            if new[name] < old[name]:
                lost[name] = f"{new[name]} of {old[name]} {what}: a part of it is missing or ends early"
        before = sum(old.values())
        if not lost and (not before or any(new.values())):
            return
        counts = f"it holds {len(old)} recordings with {before} {what}, the new one {holds}"
    named = [f"{clean(name)} ({quoted(lost[name], longest=_LONGEST_REASON)})" for name in list(lost)[:_SHOWN]]
    more = [f"and {len(lost) - _SHOWN} more"] if len(lost) > _SHOWN else []
    told = f" Would be lost: {'; '.join(named + more)}." if named else ""
    problem = f"{folder}: not replaced: {counts}.{told} What stands there is untouched, and finished parts are kept. Is"
    problem += " all of the data there (`prbench inspect`)? Then run the same command again; with `--replace` to"
    raise RecordingsWouldBeLost(f"{problem} replace it all the same, or with another --out to have both.") from None


_ROW_GROUP_ROWS = 256
_LARGEST_PART_BYTES = 512 * 1024**2
_ROWS = {
    "sequences": "One prime-and-reach sequence: from 2 s before the first look at the goal to the pick or put.",
    "events": "One candidate pick or put, with what became of it and the number that decided.",
    "recordings": "One recording that was found, with counts of its events by outcome.",
    "scenes": "The box of one thing that stands still through a recording, such as a piece of furniture.",
}


def write_table(path: Path, batches: Batches, schema: pa.Schema, *, protocol_version: int) -> int:
    """Write batches as one Parquet file, whole or not at all.

    Returns:
        The number of rows.
    """
    rows = 0
    with atomic_path(path) as temporary:
        writer = _PartWriter(
            temporary, table_schema.with_metadata(schema, protocol_version=protocol_version), _ROW_GROUP_ROWS
        )
        for batch in batches:
            rows += batch.num_rows
            writer.append(batch)
        writer.close()
    return rows


def write_table_in_parts(
    folder: Path,
    name: str,
    batches: Batches,
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
    schema = table_schema.with_metadata(schema, protocol_version=protocol_version)
    with atomic_folder(parts) as temporary:
        writer = _PartWriter(temporary / "part-00000.parquet", schema, row_group_rows)
        for batch in batches:
            if writer.bytes_written >= largest_part:
                writer.close()
                writer = _PartWriter(temporary / f"part-{count:05d}.parquet", schema, row_group_rows)
                count += 1
            rows += batch.num_rows
            writer.append(batch)
        writer.close()
    if count == 1:
        (parts / "part-00000.parquet").replace(single)
        parts.rmdir()
    else:
        single.unlink(missing_ok=True)
    return rows


class _PartWriter:
    """One Parquet file, filled in row groups of a fixed number of rows whatever the size of the batches."""

    def __init__(self, path: Path, schema: pa.Schema, row_group_rows: int) -> None:
        self._schema = schema
        self._row_group_rows = row_group_rows
        self._pending: list[pa.RecordBatch] = []
        self._pending_rows = 0
        self._file = open(path, "wb")  # noqa: SIM115 - closed in close()
        leaves = [leaf for field in schema for leaf in _leaf_paths(field.name, field.type)]
        others = [leaf for leaf, kind in leaves if not pa.types.is_floating(kind)]
        floats = [leaf for leaf, kind in leaves if pa.types.is_floating(kind)]
        self._writer = pq.ParquetWriter(
            self._file,
            schema,
            compression="zstd",
            compression_level=1,
            use_dictionary=others,  # type: ignore[arg-type] - the stub knows bool only
            column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
            write_statistics=others,  # type: ignore[arg-type]
            write_page_checksum=True,
        )

    @property
    def bytes_written(self) -> int:
        """Bytes in the file so far, whole row groups only."""
        return self._file.tell()

    def append(self, batch: pa.RecordBatch) -> None:
        """Take up rows; complete row groups go to the file."""
        self._pending.append(batch)
        self._pending_rows += batch.num_rows
        if self._pending_rows >= self._row_group_rows:
            self._flush(everything=False)

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


def _leaf_paths(path: str, kind: pa.DataType) -> list[tuple[str, pa.DataType]]:
    """Return the Parquet names of the leaf columns of a column, and their types."""
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        return _leaf_paths(f"{path}.list.element", kind.value_type)
    if pa.types.is_struct(kind):
        return [leaf for field in kind for leaf in _leaf_paths(f"{path}.{field.name}", field.type)]
    return [(path, kind)]


def write_dataset(
    folder: Path,
    info: DatasetInfo,
    *,
    sequences: Batches,
    events: Batches,
    recordings: Batches,
    scenes: Batches = (),
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
        lost = {"outcome": "sequence", "what": "sequences", "incomplete": incomplete}
        require_no_loss(folder, FILE_NAME, recordings, **lost)
    tables = {"sequences": sequences, "events": events, "recordings": recordings}
    schemas = dict(table_schema.DATASET_TABLES)
    boxes = [batch for batch in scenes if batch.num_rows]
    if boxes:
        tables["scenes"] = boxes
        schemas |= table_schema.OPTIONAL_TABLES
    with atomic_folder(folder) as temporary:
        info = write_tables(temporary, info, tables, schemas, SequenceTable.identity_columns)
        write_croissant(temporary, info, schemas, _ROWS)
        if protocol is not None:
            write_protocol(temporary, protocol)
    return info


def with_splits(batches: Batches, splits: Mapping[str, str]) -> Iterator[pa.RecordBatch]:
    """Yield rows of ``sequences`` or ``recordings`` with the split of their recording.

    Args:
        batches: Rows with the columns ``recording_id`` and ``split``.
        splits: Maps each recording to its split.
    """
    for batch in batches:
        new = pa.array([splits[name] for name in batch["recording_id"].to_pylist()])
        yield batch.set_column(batch.schema.get_field_index("split"), batch.schema.field("split"), new)


def write_tables(
    folder: Path,
    info: Info,
    tables: Mapping[str, Batches],
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
    content = table_schema.ContentDigest(schemas[main].names)
    identifying = [schemas[main].empty_table().select(list(identity_columns))]

    def passed_on(batches: Batches) -> Iterator[pa.RecordBatch]:
        for batch in batches:
            content.update(batch)
            identifying.append(pa.Table.from_batches([batch.select(list(identity_columns))]))
            yield batch

    rows = passed_on(tables[main])
    write_table_in_parts(folder, main, rows, schemas[main], protocol_version=version, row_group_rows=row_group_rows)
    for name in others:
        write_table(folder / f"{name}.parquet", tables[name], schemas[name], protocol_version=version)
    info = msgspec.structs.replace(
        info,
        identity_digest=table_schema.identity_of_rows(
            pa.concat_tables(identifying, promote_options="default"), protocol_version=version
        ),
        content_digest=content.hexdigest(),
        file_digests=table_schema.digests_of_files(folder, schemas),
    )
    info.write(folder)
    return info
