"""Positions of any common world as Y up, right-handed, metres, and whether left is where left should be."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.representation.checks import IN_MEMORY
from prbench.skeleton import Joint

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

_BEND = 0.01  # metres between knee and the line from hip to ankle; below it a leg says nothing about its front
_BACKWARDS = -0.3  # mean cosine between the front of the legs and that of the hips


def to_y_up(
    points: Float[np.ndarray, "*batch 3"], *, up: str = "y", left_handed: bool = False, unit: str | float = "m"
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
    turned = points[..., columns] * (signs * metres_of(unit)).astype(points.dtype)
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


def front_of_legs(joints: Float[np.ndarray, "frames 22 3"], *, feet: bool = True) -> float | None:
    """How far feet and bent knees point to where hips and shoulders say that the front is.

    Args:
        joints: Y up, right-handed, metres.
        feet: False if the toes were computed from the hips, so that only the knees know.

    Returns:
        Mean cosine on the ground plane, 1 for a body that is in order, -1 where left and right are exchanged (or where
        a left-handed world was not said to be one); None if legs are straight throughout and feet are not asked.
    """
    across = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
    across = across + joints[:, Joint.LEFT_SHOULDER] - joints[:, Joint.RIGHT_SHOULDER]
    front = np.stack([-across[:, 2], across[:, 0]], axis=-1)
    pointers = [_knee_bends(joints)]
    if feet:
        pointers += [joints[:, Joint.LEFT_FOOT] - joints[:, Joint.LEFT_ANKLE]]
        pointers += [joints[:, Joint.RIGHT_FOOT] - joints[:, Joint.RIGHT_ANKLE]]
    pointing = np.stack(pointers)[..., ::2]  # (pointers, frames, 2)
    length = np.linalg.norm(pointing, axis=-1)
    size = length * np.linalg.norm(front, axis=-1)
    told = length > _BEND
    if not told.any():
        return None
    cosine = (pointing * front).sum(axis=-1) / np.where(size > 0, size, 1.0)
    return float((cosine * length)[told].sum() / length[told].sum())


def check_sides(joints: Float[np.ndarray, "frames 22 3"], *, feet: bool = True, source: Path | str = IN_MEMORY) -> None:
    """Refuse a body whose feet and knees point to its back.

    Args:
        joints: Y up, right-handed, metres.
        feet: See :func:`front_of_legs`.
        source: File or name that the message begins with.

    Raises:
        InputFileError: if left and right are exchanged, or the world is left-handed.
    """
    cosine = front_of_legs(joints, feet=feet)
    if cosine is not None and cosine < _BACKWARDS:
        raise InputFileError(
            source,
            "left and right",
            expected="feet and knees that point to the body's front",
            found=f"a mean cosine of {cosine:.2f} between them and the front that hips and shoulders give",
            remedy="Left and right joints are exchanged, or the world is left-handed: check the order of the joints,"
            " then say left_handed=True.",
        )


def _knee_bends(joints: np.ndarray) -> np.ndarray:
    """Sum over both legs of the knee's offset from the line between hip and ankle (frames, 3)."""
    bends = np.zeros((len(joints), 3))
    for hip, knee, ankle in (
        (Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.LEFT_ANKLE),
        (Joint.RIGHT_HIP, Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE),
    ):
        leg = joints[:, ankle] - joints[:, hip]
        part = ((joints[:, knee] - joints[:, hip]) * leg).sum(axis=-1) / np.maximum((leg**2).sum(axis=-1), 1e-12)
        bends += joints[:, knee] - joints[:, hip] - part[:, None] * leg
    return bends
