"""Arrow columns as NumPy arrays and back: rows of a table are read as views of Arrow's buffers."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable
from collections.abc import Sequence as SequenceOf
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int, Shaped

from prbench.geometry.skeleton import N_JOINTS
from prbench.sequences.columns import KEY_VALUES

_SHAPES = {N_JOINTS * 3: (N_JOINTS, 3), 16: (4, 4)}
"""Shapes of vectors that stand for more than a vector, by their length."""


@dataclass(frozen=True)
class SequenceChunk:
    """Some rows of a sequence table. Columns that were not asked for are absent from ``batch``."""

    batch: pa.RecordBatch

    def __len__(self) -> int:
        return self.batch.num_rows

    @property
    def sequence_ids(self) -> list[str]:
        """One id a row."""
        return self.strings("sequence_id")

    @property
    def n_frames(self) -> Int[np.ndarray, " batch"]:
        """Frames of each row."""
        return self.numbers("n_frames").astype(np.int64)

    @property
    def offsets(self) -> Int[np.ndarray, " offsets"]:
        """First position of each row in the arrays that :meth:`frames` returns; one more than there are rows."""
        return np.concatenate(([0], np.cumsum(self.n_frames)))

    @property
    def joints(self) -> Float[np.ndarray, "total 22 3"]:
        """Joint positions of all rows after one another, canonical frames, metres, float32."""
        return self.frames("joints").reshape(-1, N_JOINTS, 3)

    def poses(self, name: str) -> Float[np.ndarray, "batch 22 3"]:
        """``previous_joints`` or ``next_joints``."""
        return self.vectors(name).reshape(-1, N_JOINTS, 3)

    def strings(self, name: str) -> list[str]:
        """A column of text; a missing value is an empty text."""
        return [value or "" for value in self.batch.column(name).to_pylist()]

    def numbers(self, name: str) -> Shaped[np.ndarray, " batch"]:
        """A column of numbers; a missing value is NaN."""
        return self.batch.column(name).to_numpy(zero_copy_only=False)

    def vectors(self, name: str) -> Float[np.ndarray, "batch size"]:
        """A column of fixed-size vectors."""
        column = self.batch.column(name)
        return column.flatten().to_numpy(zero_copy_only=False).reshape(len(column), column.type.list_size)

    def frames(self, name: str) -> np.ndarray:
        """A column of per-frame values, (total frames, size) or (total frames,); rows without a value have none."""
        items = self.batch.column(name).flatten()
        if not pa.types.is_fixed_size_list(items.type):
            return items.to_numpy(zero_copy_only=False)
        return items.flatten().to_numpy(zero_copy_only=False).reshape(len(items), items.type.list_size)

    def take(self, rows: SequenceOf[int] | np.ndarray) -> SequenceChunk:
        """The given rows, in the given order (copies)."""
        return SequenceChunk(self.batch.take(pa.array(np.asarray(rows, dtype=np.int64))))


def row_batch(rows: Iterable[Any], schema: pa.Schema, *, counted: Collection[str] = ()) -> pa.RecordBatch:
    """Arrow rows of objects whose attributes bear the names of the columns, in the order given.

    Args:
        rows: The objects.
        schema: The columns.
        counted: Columns that are counts from the mapping ``outcomes`` of each object; 0 where it lacks one.
    """
    rows = list(rows)
    columns = []
    for field in schema:
        name = field.name
        values = [row.outcomes.get(name, 0) if name in counted else getattr(row, name) for row in rows]
        columns.append(column(values, field.type))
    return pa.RecordBatch.from_arrays(columns, schema=schema)


def column(values: list, kind: pa.DataType) -> pa.Array:
    """Values of one column as Arrow: arrays (n, size) or (size,) where the type is bulky, plain values otherwise."""
    if pa.types.is_fixed_size_list(kind):
        return _vectors(values, kind)
    if kind == KEY_VALUES:
        pairs = [[{"key": key, "value": text} for key, text in sorted(value.items())] for value in values]
        return pa.array(pairs, type=kind)
    if pa.types.is_list(kind) and pa.types.is_struct(kind.value_type):  # data classes with the fields of the struct
        return pa.array([[asdict(item) for item in value] for value in values], type=kind)
    if pa.types.is_list(kind) and not pa.types.is_string(kind.value_type):
        return _ragged(values, kind)
    return pa.array(values, type=kind)


def row_values(column: pa.Array) -> list[Any]:
    """Return a column's values as the records hold them, one a row; arrays are read-only views of the column.

    Args:
        column: A column of a table whose rows are records; nulls become None.
    """
    kind = column.type
    if kind == KEY_VALUES:
        return [{pair["key"]: pair["value"] for pair in row or ()} for row in column.to_pylist()]
    if pa.types.is_fixed_size_list(kind):
        # A null row has its place among the values, too, which flatten() would leave out.
        items = column.values.slice(column.offset * kind.list_size, len(column) * kind.list_size)
        array = _read_only(items).reshape(-1, *_SHAPES.get(kind.list_size, (kind.list_size,)))
        arrays = list(array)
    elif pa.types.is_list(kind):
        items = column.flatten()
        if pa.types.is_fixed_size_list(items.type):
            size = items.type.list_size
            array = _read_only(items.flatten()).reshape(-1, *_SHAPES.get(size, (size,)))
        else:
            array = _read_only(items)
        ends = np.cumsum(column.value_lengths().fill_null(0).to_numpy(zero_copy_only=False))
        arrays = [array[start:end] for start, end in itertools.pairwise([0, *ends.tolist()])]
    else:
        return column.to_pylist()
    if not column.null_count:
        return arrays
    return [array if valid else None for array, valid in zip(arrays, column.is_valid().to_pylist(), strict=True)]


def _read_only(items: pa.Array) -> np.ndarray:
    array = items.to_numpy(zero_copy_only=False)
    array.setflags(write=False)
    return array


def _vectors(values: list[np.ndarray | None], kind: pa.FixedSizeListType) -> pa.Array:
    missing = [value is None for value in values]
    filler = np.zeros(kind.list_size)
    flat = [np.ravel(filler if value is None else value) for value in values]
    numbers = np.concatenate(flat) if flat else np.empty(0)
    mask = pa.array(missing, type=pa.bool_()) if any(missing) else None
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=kind.value_type), type=kind, mask=mask)


def _ragged(values: list[np.ndarray | None], kind: pa.ListType) -> pa.Array:
    lengths = [0 if value is None else len(value) for value in values]
    # int32, because Arrow's list (unlike large_list) has such offsets.
    offsets = np.concatenate(([0], np.cumsum(lengths))).astype(np.int32)
    inner = kind.value_type
    present = [value for value in values if value is not None]
    if pa.types.is_fixed_size_list(inner):
        numbers = np.concatenate([np.ravel(value) for value in present]) if present else np.empty(0)
        items = pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=inner.value_type), type=inner)
    else:
        items = pa.array(np.concatenate(present) if present else np.empty(0, dtype=bool), type=inner)
    mask = pa.array([value is None for value in values]) if len(present) < len(values) else None
    return pa.ListArray.from_arrays(pa.array(offsets), items, type=kind, mask=mask)
