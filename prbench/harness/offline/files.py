"""Conditions files on disk: Parquet with the wire protocol's columns, or plain arrays that NumPy alone can read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.contract import Condition, ConditionBatch
from prbench.errors import InputFileError
from prbench.files.arrays import Archive, read_parquet
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_path
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.offline.conditions_file import (
    DEFAULT_BATCH_SIZE,
    METADATA_KEY,
    ConditionsFile,
    ConditionsInfo,
    given_columns,
    require_suffix,
)

_LARGEST_ARRAY = 8 * 1024**3
_POSE = (N_JOINTS, 3)
_FORMS: dict[str, tuple[str, tuple[int, ...]]] = {
    "opaque_id": ("U", ()),
    "sample": ("<i4", ()),
    "noise_seed": ("<i8", ()),
    "n_frames": ("<i4", ()),
    "fps": ("<f8", ()),
    "text": ("U", ()),
    "initial_joints": ("<f4", _POSE),
    "previous_joints": ("<f4", _POSE),
    "goal_joints": ("<f4", _POSE),
    "goal_location": ("<f8", (3,)),
}
"""Kind of each array, and the shape of one row of it."""
_ALWAYS = ("opaque_id", "sample", "noise_seed", "n_frames", "fps")
_ROW_GROUP_ROWS = 1024


def write_conditions(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        StorageError: if the file cannot be written.
    """
    require_suffix(path)
    (_write_parquet if path.suffix.lower() == ".parquet" else _write_npz)(conditions, path)


@foreign_input()
def read_conditions_file(path: Path) -> ConditionsFile:
    """Read a conditions file with all its columns.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    require_suffix(path)
    return _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_npz(path)


def read_conditions(path: Path, *, batch_size: int = DEFAULT_BATCH_SIZE) -> list[ConditionBatch]:
    """The batches of a conditions file as a method gets them in a run; sample after sample.

    Args:
        path: The file.
        batch_size: Largest number of rows in a batch.

    Raises:
        UsageError: if the suffix is neither ``.parquet`` nor ``.npz``.
        InputFileError: if the file is missing, damaged, or no conditions file.
    """
    return [each.batch for each in read_conditions_file(path).batches(batch_size)]


def _write_npz(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    names = (*_ALWAYS, *given_columns(conditions.info.condition))
    arrays: dict[str, Any] = {METADATA_KEY: np.array(conditions.info.as_json())}
    arrays |= {name: np.asarray(getattr(conditions, name)).astype(_FORMS[name][0]) for name in names}
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def _read_npz(path: Path) -> ConditionsFile:
    """Read a conditions file.

    Raises:
        InputFileError: if it is missing, damaged, or not one that prbench wrote.
    """
    archive = Archive(path)
    if METADATA_KEY not in archive.members:
        raise InputFileError(
            path,
            "",
            expected=f"a conditions file (with an array '{METADATA_KEY}')",
            found=f"the arrays {', '.join(sorted(archive.members)[:10])} without it",
            remedy="Export it with `prbench export-conditions`.",
        )
    info = ConditionsInfo.from_json(str(archive.read(METADATA_KEY, largest=1024**2)), path)
    names = (*_ALWAYS, *given_columns(info.condition))
    if set(archive.members) != {METADATA_KEY, *names}:
        found = ", ".join(sorted(set(archive.members) - {METADATA_KEY}))
        raise InputFileError(path, "", expected=f"the arrays {', '.join(names)}", found=found)
    arrays = {name: archive.read(name, largest=_LARGEST_ARRAY) for name in names}
    for name, values in arrays.items():
        _require_form(path, name, values, rows=len(arrays["n_frames"]))
    columns: dict[str, Any] = {
        name: tuple(values.tolist()) if values.dtype.kind == "U" else values for name, values in arrays.items()
    }
    return ConditionsFile(info=info, **columns)


def _require_form(path: Path, name: str, values: np.ndarray, *, rows: int) -> None:
    kind, shape = _FORMS[name]
    right_kind = values.dtype.kind == "U" if kind == "U" else values.dtype == np.dtype(kind)
    if not right_kind or values.shape != (rows, *shape):
        raise InputFileError(
            path,
            f"'{name}'",
            expected=f"shape {(rows, *shape)} of {'text' if kind == 'U' else np.dtype(kind)}",
            found=f"{values.shape} of {values.dtype}",
        )


def _write_parquet(conditions: ConditionsFile, path: Path) -> None:
    """Write a conditions file; the same rows give the same bytes.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    schema = _schema_of(conditions.info.condition)
    columns = [_column(getattr(conditions, field.name), field.type) for field in schema]
    table = pa.Table.from_arrays(columns, schema=schema.with_metadata({METADATA_KEY: conditions.info.as_json()}))
    with atomic_path(path) as temporary:
        pq.write_table(
            table,
            temporary,
            row_group_size=_ROW_GROUP_ROWS,
            compression="zstd",
            compression_level=1,
            # Ids and numbers hardly repeat, so that dictionaries would only make the file larger.
            use_dictionary=["text"],  # type: ignore[arg-type] - the stub knows bool only
            write_page_checksum=True,
        )


def _schema_of(condition: Condition) -> pa.Schema:
    """The columns of a condition."""
    names = (*_ALWAYS, *given_columns(condition))
    return pa.schema([pa.field(name, _arrow_type(*_FORMS[name]), nullable=False) for name in names])


def _arrow_type(kind: str, shape: tuple[int, ...]) -> pa.DataType:
    item = pa.string() if kind == "U" else pa.from_numpy_dtype(np.dtype(kind))
    return pa.list_(item, math.prod(shape)) if shape else item


@foreign_input()
def _read_parquet(path: Path) -> ConditionsFile:
    """Read a conditions file.

    Raises:
        InputFileError: if it is missing, damaged, or not one that prbench wrote.
    """
    try:
        table = read_parquet(path, verify=True)
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
    expected = _schema_of(info.condition)
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
    kind = column.type
    whole = column.combine_chunks()
    if pa.types.is_string(kind):
        return tuple(whole.to_pylist())
    if pa.types.is_fixed_size_list(kind):
        shape = (N_JOINTS, 3) if kind.list_size > 3 else (3,)
        return whole.flatten().to_numpy().reshape(-1, *shape)
    return whole.to_numpy()


def _shown(schema: pa.Schema) -> str:
    return ", ".join(f"{field.name} {field.type}" for field in schema)
