"""Read the transforms that bring the suit's frame and the scan into one world.

Source: docs/specification/gimo.md#coordinate-chain.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import read_text
from prbench.limits import HARMLESS_SIZE
from prbench.readers.files import decode_json, must_exist
from prbench.readers.gimo import format as gimo

_ROTATION_TOLERANCE = 1e-3


class _TransformInfo(msgspec.Struct):
    scale: float
    transformation: list[list[float]]


_INFO = msgspec.json.Decoder(_TransformInfo)
_MATRIX = msgspec.json.Decoder(dict[str, list[list[float]]])


def read_transform(info: Path, norm: Path) -> gimo.SceneTransform:
    """Scale and both matrices of a segment.

    Raises:
        InputFileError: if a file is missing or no 4x4 rigid transform, or there is no positive scale.
    """
    content = decode_json(info, _INFO)
    if not np.isfinite(content.scale) or content.scale <= 0:
        raise InputFileError(info, "scale", expected="a positive number", found=f"{content.scale}")
    return gimo.SceneTransform(
        content.scale,
        _rigid(info, "transformation", np.array(content.transformation, dtype=object)),
        read_matrix(norm),
    )


def read_matrix(path: Path) -> Float[np.ndarray, "4 4"]:
    """A rigid transform from a text file of sixteen numbers, or a JSON file whose first entry is a 4x4 list.

    Raises:
        InputFileError: if the file is missing, or holds anything else.
    """
    if path.suffix == ".json":
        rows = next(iter(decode_json(path, _MATRIX).values()), [])
        return _rigid(path, "", np.array(rows, dtype=object))
    try:
        with must_exist(path):
            words = read_text(path, largest=HARMLESS_SIZE).replace(",", " ").split()
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise InputFileError(path, "", expected="a 4x4 matrix of numbers", found=str(error)) from error
    return _rigid(path, "", numbers)


def _rigid(path: Path, where: str, values: np.ndarray) -> Float[np.ndarray, "4 4"]:
    try:
        numbers = values.astype(np.float64)
    except (ValueError, TypeError) as error:
        raise InputFileError(path, where, expected="a 4x4 matrix of numbers", found="rows of unequal length") from error
    if numbers.size != 16:
        raise InputFileError(
            path,
            where,
            expected="a 4x4 matrix",
            found=f"{numbers.size} numbers",
            remedy="Copy the file again.",
        )
    matrix = numbers.reshape(4, 4)
    rotation = matrix[:3, :3]
    if not np.isfinite(matrix).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > _ROTATION_TOLERANCE:
        raise InputFileError(
            path,
            where,
            expected="a rotation with a translation (the scale stands apart)",
            found="a matrix that stretches, or NaN",
        )
    if np.linalg.det(rotation) < 0:
        raise InputFileError(path, where, expected="a rotation with a translation", found="a reflection")
    return matrix
