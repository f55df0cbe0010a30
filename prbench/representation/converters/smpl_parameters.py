"""Pose, place and shape of a body as SMPL, SMPL-H and SMPL-X write them.

Source: docs/specification/humanml3d.md#body-model-parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import N_JOINTS
from prbench.representation.converters.smpl_rotations import RotationForm, numbers_of, quaternions_of

_PARAMETERS = "parameters"
"""Name in messages of arrays that come from no file."""

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate")


@dataclass(frozen=True)
class SmplParameters:
    """One motion. Rotations of the 22 body joints, of the pelvis in the world and of the others in their parents."""

    rotations: Float[np.ndarray, "frames 22 4"]
    """Unit quaternions, w x y z."""
    transl: Float[np.ndarray, "frames 3"]
    """The model's translation, metres: the pelvis lies at this plus the *rest pelvis*, which is not the origin."""
    betas: Float[np.ndarray, " shapes"] | None = None
    """Shape of the person; None for the model's mean body."""
    gender: str | None = None
    """Model that the shape belongs to: ``neutral``, ``male`` or ``female``; None if unknown."""
    fps: float | None = None
    """Frames a second, where a file says it."""

    @classmethod
    def from_arrays(
        cls,
        *,
        global_orient: Float[np.ndarray, "_frames ..."],
        body_pose: Float[np.ndarray, "_frames ..."],
        transl: Float[np.ndarray, "frames 3"],
        betas: Float[np.ndarray, "..."] | None = None,
        form: RotationForm = "axis-angle",
        gender: str | None = None,
        source: Path | str = _PARAMETERS,
    ) -> SmplParameters:
        """Read the arguments that the package ``smplx`` has, under its names.

        Args:
            global_orient: Rotation of the pelvis in the world; any shape of the right size a frame.
            body_pose: Rotations of joints 1 to 21 (SMPL-H, SMPL-X) or 1 to 23 (SMPL) in their parents; those of the
                hands are left away, they move none of the 22 joints.
            transl: Metres.
            betas: (shapes,) or (frames, shapes); of several rows the mean is taken, because a body keeps its shape.
            form: How rotations are written; the same for both.
            gender: Of the model.
            source: Name that messages begin with.

        Raises:
            InputFileError: if an array has another size, or a number is no rotation.
        """
        frames = len(transl)
        poses = np.concatenate(
            [_flat(global_orient, frames, "global_orient", source), _flat(body_pose, frames, "body_pose", source)],
            axis=1,
        )
        return cls.from_poses(poses, transl, betas=betas, form=form, gender=gender, source=source)

    @classmethod
    def from_poses(
        cls,
        poses: Float[np.ndarray, "_frames ..."],
        transl: Float[np.ndarray, "frames 3"],
        *,
        betas: Float[np.ndarray, "..."] | None = None,
        form: RotationForm = "axis-angle",
        gender: str | None = None,
        source: Path | str = _PARAMETERS,
    ) -> SmplParameters:
        """Read one array of rotations, pelvis first (``poses`` of AMASS: 72, 156 or 165 numbers a frame).

        Args:
            poses: At least 22 rotations a frame, in the order of SMPL; what follows is left away.
            transl: ``trans`` of AMASS, metres.
            betas: As in :meth:`from_arrays`.
            form: How rotations are written.
            gender: Of the model.
            source: Name that messages begin with.

        Raises:
            InputFileError: if an array has another size, or a number is no rotation.
        """
        numbers = numbers_of(form)
        flat = _flat(poses, len(transl), "poses", source)
        if flat.shape[1] < N_JOINTS * numbers or flat.shape[1] % numbers:
            raise InputFileError(
                source,
                "poses",
                expected=f"{N_JOINTS} or more rotations of {numbers} numbers a frame ({form})",
                found=f"{flat.shape[1]} numbers",
                remedy="Name the form of the rotations, and give global_orient and body_pose both.",
            )
        if not len(transl) or transl.shape[1:] != (3,) or not np.isfinite(transl).all():
            raise InputFileError(source, "transl", expected="finite (frames, 3)", found=str(transl.shape))
        rotations = quaternions_of(flat[:, : N_JOINTS * numbers], form, source=source)
        return cls(rotations, transl.astype(np.float64), _one_shape(betas, source), gender)


@foreign_input()
def read_amass(path: Path) -> SmplParameters:
    """A motion in the layout of AMASS: SMPL-H (``mocap_framerate``) or SMPL-X (``mocap_frame_rate``); Z up.

    Raises:
        InputFileError: if the file is missing, no archive of plain arrays, or lacks ``poses`` or ``trans``.
    """
    archive = Archive(path)
    archive.require(("poses", "trans"))
    arrays = archive.load(("poses", "trans", "betas", "gender", *_RATE_KEYS))
    gender = _text(arrays["gender"]) if "gender" in arrays else None
    rates = [_rate(path, key, arrays[key]) for key in _RATE_KEYS if key in arrays]
    parameters = SmplParameters.from_poses(
        arrays["poses"], arrays["trans"], betas=arrays.get("betas"), gender=gender, source=path
    )
    return replace(parameters, fps=rates[0] if rates else None)


def _rate(path: Path, key: str, value: np.ndarray) -> float:
    if value.size != 1 or value.dtype.kind not in "fiu":
        raise InputFileError(path, key, expected="a number", found=f"shape {value.shape} of {value.dtype}")
    return float(value.reshape(-1)[0])


def _text(value: np.ndarray) -> str:
    """A word that NumPy holds as text or as bytes."""
    return value.item().decode("ascii", "replace") if value.dtype.kind == "S" else str(value)


def _flat(values: np.ndarray, frames: int, name: str, source: Path | str) -> np.ndarray:
    if values.ndim < 2 or len(values) != frames:
        raise InputFileError(
            source, name, expected=f"{frames} frames of rotations, as many as transl", found=str(values.shape)
        )
    return values.reshape(frames, -1)


def _one_shape(betas: np.ndarray | None, source: Path | str) -> np.ndarray | None:
    if betas is None:
        return None
    if betas.ndim not in (1, 2) or not betas.size or not np.isfinite(betas).all():
        raise InputFileError(source, "betas", expected="finite (shapes,) or (frames, shapes)", found=str(betas.shape))
    return betas.reshape(-1, betas.shape[-1]).astype(np.float64).mean(axis=0)
