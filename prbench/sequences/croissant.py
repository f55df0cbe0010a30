"""``croissant.json``: what a built dataset is, in the words that dataset search engines and loaders understand.

JSON-LD of the Croissant vocabulary 1.1 (https://docs.mlcommons.org/croissant/), one record set a table, one field a
column. It holds no time of day, host or path, like ``dataset.json`` beside it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa

from prbench.files.storage import file_digest, write_json
from prbench.sequences.columns import KEY_VALUES
from prbench.sequences.dataset_info import DatasetInfo
from prbench.sequences.digests import files_of_table

FILE_NAME = "croissant.json"

_PARQUET = "application/x-parquet"
_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "arrayShape": "cr:arrayShape",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isArray": "cr:isArray",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


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
        "@context": _CONTEXT,
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


def _files(folder: Path, name: str) -> list[dict[str, Any]]:
    """The file of a table, or its parts and the set that they form."""
    files = [_file(path, path.relative_to(folder).as_posix()) for path in files_of_table(folder, name)]
    if (folder / f"{name}.parquet").is_file():
        return files
    part_set = {
        "@type": "cr:FileSet",
        "@id": _part_set(name),
        "name": _part_set(name),
        "encodingFormat": _PARQUET,
        "includes": f"{name}/part-*.parquet",
        "containedIn": [{"@id": file["@id"]} for file in files],
    }
    return [*files, part_set]


def _part_set(name: str) -> str:
    """Id of the set that a table's parts form; the table's own name is its record set's, and ids are unique."""
    return f"{name}-parts"


def _file(path: Path, name: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{path.stat().st_size} B",
        "encodingFormat": _PARQUET,
        "sha256": file_digest(path),
    }


def _record_set(folder: Path, name: str, schema: pa.Schema, description: str) -> dict[str, Any]:
    single = folder / f"{name}.parquet"
    source = {"fileObject": {"@id": single.name}} if single.is_file() else {"fileSet": {"@id": _part_set(name)}}
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "key": {"@id": f"{name}/{schema.names[0]}"},
        "field": [_field(name, field, source) for field in schema],
    }


def _field(table: str, field: pa.Field, source: dict[str, Any]) -> dict[str, Any]:
    described: dict[str, Any] = {
        "@type": "cr:Field",
        "@id": f"{table}/{field.name}",
        "name": field.name,
        "description": f"{field.type}, explained in the table page of prbench's documentation",
    }
    source = source | {"extract": {"column": field.name}}
    if field.type == KEY_VALUES:
        pair = [_of_pair(described["@id"], name, source) for name in ("key", "value")]
        return described | {"isArray": True, "arrayShape": "-1", "subField": pair}
    shape, kind = _shape(field.type)
    described |= {"dataType": kind, "source": source}
    if shape:
        described |= {"isArray": True, "arrayShape": ",".join(map(str, shape))}
    return described


def _of_pair(parent: str, name: str, source: dict[str, Any]) -> dict[str, Any]:
    """The keys, or the values, of a column of key-value pairs."""
    return {
        "@type": "cr:Field",
        "@id": f"{parent}/{name}",
        "name": name,
        "dataType": "sc:Text",
        "source": source | {"transform": {"jsonPath": f"$[*].{name}"}},
    }


def _shape(kind: pa.DataType) -> tuple[list[int], str]:
    """Shape (-1 = any length) and Croissant type of one value of a column."""
    shape = []
    # Lists nest: frames of poses are a list of fixed-size lists.
    while pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        shape.append(kind.list_size if pa.types.is_fixed_size_list(kind) else -1)
        kind = kind.value_type
    if pa.types.is_floating(kind):
        return shape, "sc:Float"
    if pa.types.is_boolean(kind):
        return shape, "sc:Boolean"
    return shape, "sc:Integer" if pa.types.is_integer(kind) else "sc:Text"
