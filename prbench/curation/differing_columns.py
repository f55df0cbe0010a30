"""Which columns of two rows differ, numbers compared to 10 µm (or as little of another unit)."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.sequences import SequenceTable
from prbench.sequences.rows import is_bulky
from prbench.sequences.schema import KEY_VALUES, SEQUENCES

Row = Mapping[str, Any]
"""Values by column; in place of per-frame values and poses their digest."""

_WITHIN = 1e-5
_DIGESTED = tuple(field.name for field in SEQUENCES if is_bulky(field.type) and field.type != KEY_VALUES)


def sequence_rows(table: SequenceTable) -> dict[str, Row]:
    """Every column of every sequence, by ``sequence_id``."""
    found: dict[str, Row] = {}
    short = [name for name in SEQUENCES.names if name not in _DIGESTED]
    for chunk in table.chunks():
        rows = chunk.batch.select(short).to_pylist()
        for index, row in enumerate(rows):
            digests = {name: _digest(chunk.batch.column(name).slice(index, 1)) for name in _DIGESTED}
            found[row["sequence_id"]] = row | digests
    return found


def differing_columns(one: Row, other: Row, *, besides: Collection[str] = ()) -> list[str]:
    """Names of the columns whose values differ, in the order of the first row.

    Args:
        one: A row.
        other: One of the same columns.
        besides: Columns that are not compared.
    """
    return [name for name in one if name not in besides and not _same(one[name], other[name])]


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= _WITHIN or one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_same(*pair) for pair in zip(one, other, strict=True))
    return one == other


def _digest(column: pa.Array) -> bytes:
    """Digest of one row's numbers, rounded to 10 µm."""
    if column.null_count:
        return b""
    while pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    values = column.to_numpy(zero_copy_only=False)
    if values.dtype != bool:
        values = np.rint(values.astype(np.float64) / _WITHIN).astype(np.int64)
    return hashlib.sha256(values.tobytes()).digest()
