"""Joint files of HumanML3D: positions, checked, or a clear no."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.skeleton import N_JOINTS, Joint

_SHORTEST_TRUNK, _LONGEST_TRUNK = 0.05, 20.0  # metres; longer ones are in millimetres


def read_joints(path: Path) -> Float[np.ndarray, "frames 22 3"]:
    """Read one file of ``new_joints``.

    Returns:
        Positions, metres, Y up, 20 frames a second.

    Raises:
        InputFileError: if it is no plain array of (frames, 22, 3), holds NaN, or is in another unit.
    """
    try:
        joints = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise InputFileError(
            path, "", expected="a plain .npy array", found=str(error)[:160], remedy="Make the file again."
        ) from error
    if not isinstance(joints, np.ndarray) or joints.ndim != 3 or joints.shape[1:] != (N_JOINTS, 3) or len(joints) < 2:
        shape = joints.shape if isinstance(joints, np.ndarray) else "several arrays"
        raise InputFileError(path, "", expected="numbers of the shape (2 or more, 22, 3)", found=str(shape))
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
