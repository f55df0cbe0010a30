"""Positions of any common world as Y up, right-handed, metres."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Num

from prbench.errors import UsageError, did_you_mean

_TURNS: Mapping[str, tuple[tuple[int, int], ...]] = MappingProxyType(
    {
        "y": ((0, 1), (1, 1), (2, 1)),
        "-y": ((0, 1), (1, -1), (2, -1)),
        "z": ((0, 1), (2, 1), (1, -1)),
        "-z": ((0, 1), (2, -1), (1, 1)),
        "x": ((1, -1), (0, 1), (2, 1)),
        "-x": ((1, 1), (0, -1), (2, 1)),
    }
)
"""For each axis that may point up: source column and sign of x, y and z; a rotation by a quarter or half turn."""

UNITS: Mapping[str, float] = MappingProxyType({"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048})
"""Metres a unit."""


def to_y_up(
    points: Num[np.ndarray, "*batch 3"], *, up: str = "y", left_handed: bool = False, unit: str | float = "m"
) -> Float[np.ndarray, "*batch 3"]:
    """Positions with Y up, right-handed, in metres.

    The heading that comes out is arbitrary; :func:`prbench.representation.converters.placed_on` or
    :func:`prbench.representation.canonicalise` gives it a meaning.

    Args:
        points: In the world of the source.
        up: Axis that points up there: ``y``, ``z``, ``x``, or one of them with a minus sign. ``-y`` is that of camera
            coordinates (x right, y down, z forward).
        left_handed: The source's axes are left-handed (Unity: Y up, Unreal: Z up). One horizontal axis is negated;
            names of joints stay, because the body is the same.
        unit: ``m``, ``cm``, ``mm``, ``inch``, ``foot``, or metres a unit.

    Raises:
        UsageError: if axis or unit is unknown.
    """
    if up not in _TURNS:
        raise UsageError(f"unknown up axis '{up}'.{did_you_mean(up, _TURNS)} Choose one of: {', '.join(_TURNS)}.")
    columns, signs = np.transpose(_TURNS[up])
    exact = np.result_type(points.dtype, np.float32)  # millimetres may come as integers
    turned = points[..., columns].astype(exact) * (signs * metres_of(unit)).astype(exact)
    if left_handed:
        turned[..., 0] = -turned[..., 0]
    return turned


def metres_of(unit: str | float) -> float:
    """Metres a unit.

    Raises:
        UsageError: if the name is unknown, or the number is none above 0.
    """
    if isinstance(unit, str):
        if unit not in UNITS:
            raise UsageError(f"unknown unit '{unit}'.{did_you_mean(unit, UNITS)} Choose one of: {', '.join(UNITS)}.")
        return UNITS[unit]
    if not (np.isfinite(unit) and unit > 0):
        raise UsageError(f"unit: expected metres a unit, a number above 0, found {unit:g}.")
    return float(unit)
