"""Python values and NumPy arrays as Arrow columns of a table's schema."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from prbench.sequences.schema import KEY_VALUES


def column(values: list, kind: pa.DataType) -> pa.Array:
    """Values of one column as Arrow: arrays (n, size) or (size,) where the type is bulky, plain values otherwise."""
    if pa.types.is_fixed_size_list(kind):
        return _vectors(values, kind)
    if kind == KEY_VALUES:
        pairs = [[{"key": key, "value": text} for key, text in sorted(value.items())] for value in values]
        return pa.array(pairs, type=kind)
    if pa.types.is_list(kind):
        return _ragged(values, kind)
    return pa.array(values, type=kind)


def _vectors(values: list[np.ndarray | None], kind: pa.FixedSizeListType) -> pa.Array:
    missing = [value is None for value in values]
    filler = np.zeros(kind.list_size)
    flat = [np.ravel(filler if value is None else value) for value in values]
    numbers = np.concatenate(flat) if flat else np.empty(0)
    mask = pa.array(missing, type=pa.bool_()) if any(missing) else None
    return pa.FixedSizeListArray.from_arrays(pa.array(numbers, type=kind.value_type), type=kind, mask=mask)


def _ragged(values: list[np.ndarray | None], kind: pa.ListType) -> pa.Array:
    lengths = [0 if value is None else len(value) for value in values]
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
