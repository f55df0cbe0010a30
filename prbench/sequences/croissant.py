"""``croissant.json``: what a built dataset is, in the words that dataset search engines and loaders understand.

JSON-LD of the Croissant vocabulary 1.1 (https://docs.mlcommons.org/croissant/), whose terms ``croissant_context.json``
holds; one record set a table, one field a column. It holds no time of day, host or path, like ``dataset.json`` beside
it.
"""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import pyarrow as pa

from prbench.files.storage import file_digest, write_json
from prbench.sequences.columns import KEY_VALUES
from prbench.sequences.dataset_info import DatasetInfo
from prbench.sequences.digests import files_of_table

FILE_NAME = "croissant.json"
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
    document: dict[str, Any] = {
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
        "distribution": [entry for name in tables for entry in _files(folder, name)],
        "recordSet": [_record_set(folder, name, schema, descriptions[name]) for name, schema in tables.items()],
    }
    if info.homepage:
        document["url"] = info.homepage
    if info.citation:
        document["citeAs"] = info.citation
    write_json(folder / FILE_NAME, document)


def _files(folder: Path, table: str) -> list[dict[str, Any]]:
    """Return the file of a table, or its parts and the set that they form."""
    entries: list[dict[str, Any]] = []
    for path in files_of_table(folder, table):
        name = path.relative_to(folder).as_posix()
        entry = {
            "@type": "cr:FileObject",
            "@id": name,
            "name": name,
            "contentUrl": name,
            "contentSize": f"{path.stat().st_size} B",
            "encodingFormat": _PARQUET,
            "sha256": file_digest(path),
        }
        entries.append(entry)
    if not (folder / f"{table}.parquet").is_file():
        part_set = {
            "@type": "cr:FileSet",
            "@id": _part_set(table),
            "name": _part_set(table),
            "encodingFormat": _PARQUET,
            "includes": f"{table}/part-*.parquet",
            "containedIn": [{"@id": entry["@id"]} for entry in entries],
        }
        entries.append(part_set)
    return entries


def _part_set(table: str) -> str:
    """Return the id of the set that a table's parts form; the table's own name is its record set's."""
    return f"{table}-parts"


def _record_set(folder: Path, name: str, schema: pa.Schema, description: str) -> dict[str, Any]:
    single = folder / f"{name}.parquet"
    source = {"fileObject": {"@id": single.name}} if single.is_file() else {"fileSet": {"@id": _part_set(name)}}
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "key": {"@id": f"{name}/{schema.names[0]}"},
        "field": [_field(name, field, source | {"extract": {"column": field.name}}) for field in schema],
    }


def _field(table: str, column: pa.Field, source: dict[str, Any]) -> dict[str, Any]:
    described: dict[str, Any] = {
        "@type": "cr:Field",
        "@id": f"{table}/{column.name}",
        "name": column.name,
        "description": f"{column.type}, explained in the table page of prbench's documentation",
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
    if shape:
        described |= {"isArray": True, "arrayShape": ",".join(shape)}
    return described
