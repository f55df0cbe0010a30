"""Joint files of HumanML3D: positions, checked, or a clear no."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.numpy_files import load_array
from prbench.skeleton import N_JOINTS, Joint

_SHORTEST_TRUNK, _LONGEST_TRUNK = 0.05, 20.0  # metres; longer ones are in millimetres


def read_joints(path: Path) -> Float[np.ndarray, "frames 22 3"]:
    """Read one file of ``new_joints``.

    Returns:
        Positions, metres, Y up, 20 frames a second.

    Raises:
        InputFileError: if it is no plain array of (frames, 22, 3), holds NaN, or is in another unit.
    """
    joints = load_array(path, remedy="Make the file again.")
    fits = joints.ndim == 3 and joints.shape[1:] == (N_JOINTS, 3) and joints.dtype.kind in "fiu"
    if not fits or len(joints) < 2:
        found = f"{joints.shape} of {joints.dtype}"
        raise InputFileError(path, "", expected="numbers of the shape (2 or more, 22, 3)", found=found)
    joints = joints.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(joints).all(axis=(1, 2)))
    if bad.size:
        raise InputFileError(
            path, f"frame {bad[0]}", expected="finite positions", found="NaN", remedy="Leave the motion out."
        )
    _require_metres(path, joints)
    return joints


def _require_metres(path: Path, joints: np.ndarray) -> None:
    trunk = float(np.median(np.linalg.norm(joints[:, Joint.HEAD] - joints[:, Joint.PELVIS], axis=-1)))
    if trunk > _LONGEST_TRUNK:
        found = f"{trunk:.0f} from pelvis to head"
        raise InputFileError(path, "", expected="metres", found=found, remedy="Divide by 1,000.")
    if trunk < _SHORTEST_TRUNK:
        raise InputFileError(path, "", expected="a body", found=f"{trunk:.4f} m from pelvis to head")
