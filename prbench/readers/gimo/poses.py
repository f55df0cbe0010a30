"""``smplx_local``: the fitted SMPL-X parameters, one pickle a frame (docs/specification/gimo.md#fitted-poses)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.pickled_tensors import load_tensors

_SIZES = {"orient": 3, "trans": 3, "latent": gimo.N_LATENT}
_SHAPE_KEYS = ("beta", "expression")


def read_poses(files: Mapping[int, Path]) -> gimo.SmplxPoses:
    """Parameters of all frames that have a file, in the order of the frames.

    Raises:
        InputFileError: if a file is damaged, names foreign classes, lacks a key, or has another size or NaN in it.
    """
    frames = sorted(files)
    rows = [_read_pose(files[frame]) for frame in frames]
    columns = {key: np.array([row[key] for row in rows]).reshape(-1, size) for key, size in _SIZES.items()}
    return gimo.SmplxPoses(np.array(frames, dtype=np.int64), **columns)


def _read_pose(path: Path) -> dict[str, np.ndarray]:
    tensors = load_tensors(path)
    pose = {}
    for key, size in _SIZES.items():
        if key not in tensors:
            raise InputFileError(path, "", expected=f"the key '{key}'", found=", ".join(sorted(tensors)) or "no keys")
        values = tensors[key].astype(np.float32).ravel()
        if values.size != size:
            raise InputFileError(
                path,
                key,
                expected=f"{size} numbers",
                found=str(values.size),
                remedy="This is the code of another pose prior, or another format." if key == "latent" else "",
            )
        if not np.isfinite(values).all():
            raise InputFileError(path, key, expected="finite numbers", found="NaN", remedy="Copy the file again.")
        pose[key] = values
    for key in _SHAPE_KEYS:
        if key in tensors and np.abs(tensors[key]).max(initial=0.0) > 0:
            raise InputFileError(
                path,
                key,
                expected="zeros: everybody is fitted with the neutral mean shape",
                found="other numbers",
                remedy="Joints of another shape cannot be computed from this format's constants.",
            )
    return pose
