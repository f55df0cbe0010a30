"""A conditions file as Parquet: the columns of the wire protocol, one row a motion to be generated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from prbench import parquet_files
from prbench.boundary import foreign_input
from prbench.contract import Condition
from prbench.errors import InputFileError
from prbench.skeleton import N_JOINTS
from prbench.storage import atomic_path
from prbench.submitted.offline.conditions_file import ConditionsFile, given_columns
from prbench.submitted.offline.information import METADATA_KEY, ConditionsInfo

_ROW_GROUP_ROWS = 1024
_POSE = pa.list_(pa.float32(), N_JOINTS * 3)
_TYPES = {
    "opaque_id": pa.string(),
    "sample": pa.int32(),
    "noise_seed": pa.int64(),
    "n_frames": pa.int32(),
    "fps": pa.float64(),
    "text": pa.string(),
    "initial_joints": _POSE,
    "previous_joints": _POSE,
    "goal_joints": _POSE,
    "goal_location": pa.list_(pa.float64(), 3),
}
_ALWAYS = ("opaque_id", "sample", "noise_seed", "n_frames", "fps")


def schema_of(condition: Condition) -> pa.Schema:
    """The columns of a condition."""
    names = (*_ALWAYS, *given_columns(condition))
    return pa.schema([pa.field(name, _TYPES[name], nullable=False) for name in names])


def write_parquet(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    schema = schema_of(conditions.info.condition)
    columns = [_column(getattr(conditions, field.name), field.type) for field in schema]
    table = pa.Table.from_arrays(columns, schema=schema.with_metadata({METADATA_KEY: conditions.info.as_json()}))
    with atomic_path(path) as temporary:
        pq.write_table(
            table,
            temporary,
            row_group_size=_ROW_GROUP_ROWS,
            compression="zstd",
            compression_level=1,
            use_dictionary=["text"],  # type: ignore[arg-type] - the stub knows bool only
            write_page_checksum=True,
        )


@foreign_input()
def read_parquet(path: Path) -> ConditionsFile:
    """Read a conditions file.

    Raises:
        InputFileError: if it is missing, damaged, or not one that prbench wrote.
    """
    try:
        table = parquet_files.read_parquet(path, verify=True)
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="a conditions file", found="no file") from error
    except (pa.ArrowInvalid, OSError) as error:
        raise InputFileError(path, "", expected="a readable Parquet file", found=str(error).splitlines()[0]) from error
    text = (table.schema.metadata or {}).get(METADATA_KEY.encode())
    if text is None:
        raise InputFileError(
            path,
            "",
            expected=f"a conditions file (with {METADATA_KEY} in its metadata)",
            found=f"the columns {', '.join(table.column_names)} without it",
            remedy="Export it with `prbench export-conditions`.",
        )
    info = ConditionsInfo.from_json(text, path)
    expected = schema_of(info.condition)
    if not table.schema.equals(expected):
        raise InputFileError(path, "", expected=f"the columns {_shown(expected)}", found=_shown(table.schema))
    columns: dict[str, Any] = {name: _values(table[name]) for name in table.column_names}
    return ConditionsFile(info=info, **columns)


def _column(values: tuple[str, ...] | np.ndarray, kind: pa.DataType) -> pa.Array:
    if isinstance(values, tuple):
        return pa.array(values, kind)
    if pa.types.is_fixed_size_list(kind):
        return pa.FixedSizeListArray.from_arrays(pa.array(values.reshape(-1), kind.value_type), type=kind)
    return pa.array(values, kind)


def _values(column: pa.ChunkedArray) -> tuple[str, ...] | np.ndarray:
    kind, whole = column.type, column.combine_chunks()
    if pa.types.is_string(kind):
        return tuple(whole.to_pylist())
    if pa.types.is_fixed_size_list(kind):
        shape = (N_JOINTS, 3) if kind.list_size > 3 else (3,)
        return whole.flatten().to_numpy().reshape(-1, *shape)
    return whole.to_numpy()


def _shown(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)
