"""Comparing nested data classes of arrays bit by bit."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

import numpy as np


def differences(first: object, second: object, path: str = "") -> Iterator[str]:
    """Paths at which two values differ; NaN equals NaN."""
    if isinstance(first, np.ndarray) and isinstance(second, np.ndarray):
        if not np.array_equal(first, second, equal_nan=first.dtype.kind == "f"):
            yield path
    elif is_dataclass(first) and type(first) is type(second):
        for field in fields(first):
            yield from differences(getattr(first, field.name), getattr(second, field.name), f"{path}.{field.name}")
    elif isinstance(first, tuple) and isinstance(second, tuple) and len(first) == len(second):
        for index, (left, right) in enumerate(zip(first, second, strict=True)):
            yield from differences(left, right, f"{path}[{index}]")
    elif isinstance(first, dict) and isinstance(second, dict) and first.keys() == second.keys():
        for key in first:
            yield from differences(first[key], second[key], f"{path}[{key!r}]")
    elif first != second:
        yield path
