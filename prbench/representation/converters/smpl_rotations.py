"""Rotations in every form in which models put them out, as unit quaternions (w x y z).

In NumPy alone, so that a program of another Python needs no SciPy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, UsageError, did_you_mean

RotationForm = Literal[
    "axis-angle", "matrix", "quaternion-wxyz", "quaternion-xyzw", "6d-columns", "6d-rows", "6d-interleaved"
]
"""``6d-columns``: first column, then second column of the matrix (HumanML3D). ``6d-rows``: first row, then second row
(PyTorch3D, and with it MDM's SMPL representation). ``6d-interleaved``: the two columns side by side, row by row
(HMR, SPIN, VPoser: ``reshape(3, 2)``)."""
_NUMBERS: Mapping[str, int] = MappingProxyType(
    {
        "axis-angle": 3, "matrix": 9, "quaternion-wxyz": 4, "quaternion-xyzw": 4, "6d-columns": 6, "6d-rows": 6,
        "6d-interleaved": 6,
    }
)  # fmt: skip
"""Numbers that a rotation takes in each form."""
_UNIT_TOLERANCE = 0.05
"""Tolerance of a quaternion's length or a matrix's determinant; networks do not end on exact rotations."""
_NO_DIRECTION = 1e-6


def from_axis_angle(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Quaternions of rotations about these axes by their lengths, radians."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    sine_over_angle = 0.5 * np.sinc(angle / (2 * np.pi))  # sin(angle / 2) / angle, 1/2 where there is no angle
    return np.concatenate([np.cos(angle / 2), sine_over_angle * vectors], axis=-1)


def from_matrices(matrices: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Quaternions of rotation matrices; their largest component is positive.

    With q the quaternion, 4 q q' is linear in the matrix. Any of its rows, divided by its length, is q; the one with
    the largest diagonal loses no digits (Shepperd, 1978).
    """
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(matrices, (-2, -1), (0, 1))
    rows = [
        [1 + a + e + i, h - f, c - g, d - b],
        [h - f, 1 + a - e - i, b + d, c + g],
        [c - g, b + d, 1 - a + e - i, f + h],
        [d - b, c + g, f + h, 1 - a - e + i],
    ]
    outer = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)  # (*batch, 4, 4)
    largest = np.diagonal(outer, axis1=-2, axis2=-1).argmax(axis=-1)
    chosen = np.take_along_axis(outer, largest[..., None, None], axis=-2)[..., 0, :]
    return chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)


def to_matrices(quaternions: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices of unit quaternions."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def numbers_of(form: str) -> int:
    """Numbers that a rotation takes in this form.

    Raises:
        UsageError: if the form is unknown.
    """
    if form not in _NUMBERS:
        raise UsageError(
            f"unknown form of rotations '{form}'.{did_you_mean(form, _NUMBERS)} Choose one of: {', '.join(_NUMBERS)}."
        )
    return _NUMBERS[form]


def quaternions_of(
    values: Float[np.ndarray, "frames numbers"], form: RotationForm, *, source: Path | str = "rotations"
) -> Float[np.ndarray, "frames joints 4"]:
    """Unit quaternions (w x y z) of each frame from its numbers, joint after joint.

    Args:
        values: As many numbers as ``joints`` rotations take.
        form: How they are written; axis-angle in radians.
        source: Name that messages begin with.

    Raises:
        UsageError: if the form is unknown.
        InputFileError: if the numbers do not divide into rotations, are not finite, or are far from any rotation
            (quaternions of another length, angles that look like degrees).
    """
    size = numbers_of(form)
    if values.shape[1] % size or not values.shape[1]:
        raise InputFileError(
            source, "", expected=f"a multiple of {size} numbers a frame ({form})", found=str(values.shape[1])
        )
    if not np.isfinite(values).all():
        frame = int(np.argwhere(~np.isfinite(values))[0, 0])
        raise InputFileError(source, f"frame {frame}", expected="finite numbers", found="NaN or infinity")
    each = values.astype(np.float64).reshape(-1, size)
    return _READ[form](each, source).reshape(len(values), -1, 4)


def _axis_angle(values: np.ndarray, source: Path | str) -> np.ndarray:
    largest = float(np.linalg.norm(values, axis=-1).max(initial=0.0))
    if largest > 4 * np.pi:
        raise InputFileError(
            source,
            "",
            expected="axis-angle in radians",
            found=f"an angle of {largest:.0f}",
            remedy="These look like degrees, or like another form of rotations.",
        )
    return from_axis_angle(values)


def _quaternion(values: np.ndarray, source: Path | str) -> np.ndarray:
    """Unit quaternions from such that a network has put out, w first."""
    lengths = np.linalg.norm(values, axis=-1)
    if np.abs(lengths - 1).max(initial=0.0) > _UNIT_TOLERANCE:
        wrong = float(lengths[np.abs(lengths - 1).argmax()])
        raise InputFileError(source, "", expected="unit quaternions", found=f"one of the length {wrong:.3g}")
    return values / lengths[:, None]


def _matrix(values: np.ndarray, source: Path | str) -> np.ndarray:
    matrices = values.reshape(-1, 3, 3)
    determinants = np.linalg.det(matrices)
    if np.abs(determinants - 1).max(initial=0.0) > 3 * _UNIT_TOLERANCE:
        wrong = float(determinants[np.abs(determinants - 1).argmax()])
        raise InputFileError(
            source, "", expected="rotation matrices", found=f"a matrix whose determinant is {wrong:.3g}"
        )
    return from_matrices(_orthonormal(matrices[..., 0], matrices[..., 1], source))


def _orthonormal(first: np.ndarray, second: np.ndarray, source: Path | str) -> np.ndarray:
    """Rotation matrices whose first two columns span the given ones (Gram-Schmidt)."""
    length = np.linalg.norm(first, axis=-1, keepdims=True)
    first = first / np.maximum(length, 1e-12)
    across = second - (first * second).sum(axis=-1, keepdims=True) * first
    width = np.linalg.norm(across, axis=-1, keepdims=True)
    if min(length.min(initial=1.0), width.min(initial=1.0)) < _NO_DIRECTION:
        raise InputFileError(
            source,
            "",
            expected="two directions a rotation",
            found="two directions that lie along one another, or none",
            remedy="Is it another of the 6d forms?",
        )
    across = across / width
    return np.stack([first, across, np.cross(first, across)], axis=-1)


_READ: Mapping[str, Callable[[np.ndarray, Path | str], np.ndarray]] = MappingProxyType(
    {
        "axis-angle": _axis_angle,
        "matrix": _matrix,
        "quaternion-wxyz": _quaternion,
        "quaternion-xyzw": lambda values, source: _quaternion(values[:, [3, 0, 1, 2]], source),
        "6d-columns": lambda values, source: from_matrices(_orthonormal(values[:, :3], values[:, 3:], source)),
        "6d-rows": lambda values, source: from_matrices(
            np.swapaxes(_orthonormal(values[:, :3], values[:, 3:], source), -1, -2)
        ),
        "6d-interleaved": lambda values, source: from_matrices(_orthonormal(values[:, ::2], values[:, 1::2], source)),
    }
)
