"""Statistics and projection that the public checkpoints were trained with: files of the original's repository."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.numpy_files import load_array
from prbench.representation.features import N_FEATURES
from prbench.storage import file_digest
from prbench_adapters.gmd.features import ROOT_XZ, FeatureSpace

RELEASED = {
    "mean": "1bb2633e77a99f1120fc1eb424b7489360bac0a8dfb579e18bd5065431b4b07e",
    "std": "9f5f12cae2003ef19fea119347346d0e46ad85c86dcd1096f1e319ee2a69f940",
    "projection": "91027345a8157fbfe31f6c75b3d341436b649194fe31158ea4419d5cf38d5abb",
}
"""SHA-256 of ``Mean_abs_3d.npy``, ``Std_abs_3d.npy`` and ``rand_proj.npy`` in the public repository."""
_LEAST_DEVIATION_OF_PLACES = 0.1
"""Metres. Where people stand deviates by decimetres; how far they step in a frame, by some centimetres."""
_MOST_OFF = 1.25
"""A draw of the projection has a sum of squares of 263, give or take some per cent; its inverse has many times that."""


def read_space(mean: Path, std: Path, projection: Path) -> FeatureSpace:
    """The feature space of the public checkpoints.

    Args:
        mean: ``Mean_abs_3d.npy``, of features with an absolute root.
        std: ``Std_abs_3d.npy``.
        projection: ``rand_proj.npy``.

    Raises:
        InputFileError: if a file is none of these.
    """
    means, deviations = _read(mean, (N_FEATURES,)), _read(std, (N_FEATURES,))
    _require_deviations(std, deviations)
    matrix = _read(projection, (N_FEATURES, N_FEATURES))
    _require_projection(projection, matrix)
    return FeatureSpace.of(torch.from_numpy(means), torch.from_numpy(deviations), torch.from_numpy(matrix))


def emphasis_of(space: FeatureSpace) -> float:
    """The weight c of the absolute root with which a projection was drawn, a whole number."""
    squares = space.projection.square().sum(dim=1)
    return float(max(1.0, torch.round((squares[:3].mean() / squares[3:].mean()).sqrt())))


def is_released(role: str, path: Path) -> bool:
    """Whether a file is, byte for byte, that of the public repository."""
    return file_digest(path) == RELEASED[role]


def _read(path: Path, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    array = load_array(path)
    if array.shape != shape:
        raise InputFileError(path, "", expected=f"an array of shape {shape}", found=f"shape {array.shape}")
    if array.dtype.kind != "f" or not np.isfinite(array).all():
        raise InputFileError(path, "", expected="finite numbers", found=f"{array.dtype} with NaN or infinity")
    return array.astype(np.float32)


def _require_deviations(path: Path, deviations: Float[np.ndarray, " 263"]) -> None:
    remedy = "Give --statistics Mean_abs_3d.npy Std_abs_3d.npy, in this order."
    least = int(deviations.argmin())
    if deviations[least] <= 0:
        found = f"{deviations[least]:g}"
        raise InputFileError(path, f"column {least}", expected="a positive deviation", found=found, remedy=remedy)
    if deviations[ROOT_XZ].max() < _LEAST_DEVIATION_OF_PLACES:
        raise InputFileError(
            path,
            "columns 1 and 2",
            expected="deviations of where the pelvis stands, some decimetres",
            found=f"{deviations[ROOT_XZ].max():.3f} m, as of its steps from frame to frame",
            remedy=f"These seem to be statistics of relative features. {remedy}",
        )


def _require_projection(path: Path, matrix: Float[np.ndarray, "263 263"]) -> None:
    size = float((matrix.astype(np.float64) ** 2).sum()) / N_FEATURES
    if not 1 / _MOST_OFF < size < _MOST_OFF or np.linalg.matrix_rank(matrix.astype(np.float64)) < N_FEATURES:
        raise InputFileError(
            path,
            "",
            expected="an emphasis projection that can be inverted, with a mean square of 1 a row",
            found=f"{size:.3g}",
            remedy="Give --projection rand_proj.npy; inv_rand_proj.npy is its inverse, which prbench computes itself.",
        )
