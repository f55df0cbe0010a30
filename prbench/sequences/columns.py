"""The columns of tables, declared by the fields of the records that become their rows.

A field's type says what Python holds and what Parquet holds: plain types stand for themselves, arrays and maps carry
their Arrow type. ``None`` among a field's types makes the column nullable.
"""

from __future__ import annotations

import types
from collections.abc import Collection, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pyarrow as pa
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import N_JOINTS

KEY_VALUES = pa.list_(pa.struct([pa.field("key", pa.string()), pa.field("value", pa.string())]))
"""A map, written as a list of pairs: readers that know no maps (Hugging Face ``datasets``) open it too."""
_POINT = pa.list_(pa.float32(), 3)
_POSE = pa.list_(pa.float32(), N_JOINTS * 3)

Texts = Annotated[Mapping[str, str], KEY_VALUES]
PrecisePoint = Annotated[Float[np.ndarray, "3"], pa.list_(pa.float64(), 3)]
Quaternion = Annotated[Float[np.ndarray, "4"], pa.list_(pa.float64(), 4)]
Transform = Annotated[Float[np.ndarray, "4 4"], pa.list_(pa.float64(), 16)]
Pose = Annotated[Float[np.ndarray, "22 3"], _POSE]
Poses = Annotated[Float[np.ndarray, "n 22 3"], pa.list_(_POSE)]
Points = Annotated[Float[np.ndarray, "n 3"], pa.list_(_POINT)]
Rotations = Annotated[Float[np.ndarray, "n 4"], pa.list_(pa.list_(pa.float32(), 4))]
Flags = Annotated[Bool[np.ndarray, " n"], pa.list_(pa.bool_())]
_PLAIN = {str: pa.string(), float: pa.float64(), int: pa.int32(), bool: pa.bool_()}


def column_field(name: str, kind: pa.DataType, *, nullable: bool = False) -> pa.Field:
    """Return a column of a table; unlike Arrow's own default, it holds no nulls unless it says so."""
    return pa.field(name, kind, nullable=nullable)


def schema_of(record: type, *, counted: Collection[str] = (), without: Collection[str] = ()) -> pa.Schema:
    """Return the columns of a table, one row of which is a record.

    Args:
        record: A data class. Its field ``outcomes``, if it has one, stands for one column of counts an outcome.
        counted: Names of these columns.
        without: Fields that the table does not hold.
    """
    hints = get_type_hints(record, include_extras=True)
    columns = []
    for field in fields(record):
        if field.name == "outcomes":
            columns += [column_field(outcome, pa.int32()) for outcome in counted]
        elif field.name not in without:
            columns.append(_column(field.name, hints[field.name]))
    return pa.schema(columns)


def _column(name: str, hint: Any) -> pa.Field:
    nullable = get_origin(hint) in (Union, types.UnionType)
    if nullable:
        (hint,) = (each for each in get_args(hint) if each is not types.NoneType)
    if get_origin(hint) is Annotated:
        kind = hint.__metadata__[0]
    elif get_origin(hint) is Literal:
        kind = pa.string()
    else:
        kind = _PLAIN[hint]
    return column_field(name, kind, nullable=nullable)
