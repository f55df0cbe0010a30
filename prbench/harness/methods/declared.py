"""The declarations of a method about itself, checked before anything depends on them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from numbers import Integral, Real
from typing import Any

from prbench.contract import Condition
from prbench.errors import AdapterError


@dataclass(frozen=True)
class Declared:
    """The attributes of an adapter that the harness honours."""

    conditions: frozenset[Any]
    """Of the benchmark's own type."""
    max_frames: int | None = None
    """Longest motion at its own rate, in frames; None for no limit."""
    native_fps: float | None = None
    """Frames per second that it generates; None for the table's rate."""
    motionless: bool = False
    gaze: bool = False
    """True if its motions bring gaze."""
    wants_obstacles: bool = False
    """Must be given the solid boxes around each sequence."""
    one_design: bool = False
    """The K futures of a window are one design: fewer are no part of more."""

    @classmethod
    def by(cls, adapter: Any, *, origin: str, conditions: type[StrEnum] = Condition) -> Declared:
        """Read the attributes of a method.

        Args:
            adapter: The method.
            origin: Name of the method in messages.
            conditions: The conditions of its benchmark.

        Raises:
            AdapterError: naming the attribute that is not what the contract asks for.
        """
        declared = cls.checked(
            adapter.conditions,
            getattr(adapter, "max_frames", None),
            getattr(adapter, "native_fps", None),
            bool(getattr(adapter, "motionless", False)),
            bool(getattr(adapter, "gaze", False)),
            origin=origin,
            known=conditions,
        )
        return replace(
            declared,
            wants_obstacles=bool(getattr(adapter, "wants_obstacles", False)),
            one_design=bool(getattr(adapter, "one_design", False)),
        )

    @classmethod
    def checked(
        cls,
        conditions: object,
        max_frames: object,
        native_fps: object,
        motionless: bool,
        gaze: bool = False,
        *,
        origin: str,
        known: type[StrEnum] = Condition,
    ) -> Declared:
        """Read the same from values of unknown types.

        Raises:
            AdapterError: see :meth:`by`.
        """
        return cls(
            _conditions(conditions, origin, known),
            _max_frames(max_frames, origin),
            _native_fps(native_fps, origin),
            motionless,
            gaze,
        )


def _conditions(value: object, origin: str, kind: type[StrEnum]) -> frozenset[Any]:
    known = [condition.value for condition in kind]
    if isinstance(value, Iterable) and not isinstance(value, str):
        # A one-shot iterator may be all that a method gives.
        found = list(value)
        if found and all(item in known for item in found):
            return frozenset(kind(item) for item in found)
    raise AdapterError(f"{origin}: expected 'conditions' to be some of {', '.join(sorted(known))}, found {value!r}.")


def _max_frames(value: object, origin: str) -> int | None:
    if value is None:
        return None
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1:
        return int(value)
    raise AdapterError(f"{origin}: expected 'max_frames' to be a whole number of 1 or more, or None, found {value!r}.")


def _native_fps(value: object, origin: str) -> float | None:
    if value is None:
        return None
    with contextlib.suppress(OverflowError):  # a whole number beyond what a float holds
        if isinstance(value, Real) and not isinstance(value, bool) and 0 < float(value) < math.inf:
            return float(value)
    raise AdapterError(f"{origin}: expected 'native_fps' to be frames per second above 0, or None, found {value!r}.")
