"""The SMPL fit of the Plus release, posed with the user's own body model (``formats/nymeria.md`` section 3)."""

from __future__ import annotations

import itertools
import zipfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.corpora.nymeria.body import BodyMotion, MotionPiece
from prbench.errors import InputFileError
from prbench.formats.egoallo import forward_kinematics
from prbench.formats.nymeria import SUIT_RATE
from prbench.skeleton import N_JOINTS, PARENTS

_FIT_KEYS = ("betas", "body_pose", "global_orient", "transl", "timestamps")
_MODEL_KEYS = ("J_regressor", "v_template", "shapedirs")
_N_BODY_JOINTS = 21


def read_smpl_fit(path: Path, model: Path, *, tolerance: float, shortest: float) -> tuple[MotionPiece, ...]:
    """The 22 joints of the fit, cut where its clock jumps.

    Args:
        path: ``xdata_smpl_neutral.npz``: Y up, metres, microseconds.
        model: SMPL neutral model as ``.npz`` with plain arrays (``J_regressor``, ``v_template``, ``shapedirs``).
        tolerance: Seconds by which a time step may differ from 1/240 s.
        shortest: Seconds; shorter pieces are left out.

    Raises:
        InputFileError: if either file lacks an array, or shapes do not fit.
    """
    fit, body = _arrays(path, _FIT_KEYS, ""), _arrays(model, _MODEL_KEYS, _HOW_TO_CONVERT)
    n = len(fit["transl"])
    shapes = {"body_pose": (n, 69), "global_orient": (n, 3), "transl": (n, 3), "timestamps": (n,)}
    for key, shape in shapes.items():
        if fit[key].shape != shape or not np.isfinite(fit[key]).all():
            raise InputFileError(path, key, expected=f"finite numbers of the shape {shape}", found=str(fit[key].shape))
    rest = _rest_joints(body, fit["betas"])
    turned = Rotation.from_rotvec(fit["body_pose"].reshape(-1, 3)).as_quat(scalar_first=True).reshape(n, -1, 4)
    root = Rotation.from_rotvec(fit["global_orient"]).as_quat(scalar_first=True)
    joints = forward_kinematics(rest, fit["transl"] + rest[0], root, turned[:, :_N_BODY_JOINTS])
    times = fit["timestamps"].astype(np.int64)
    jumps = np.flatnonzero(np.abs(np.diff(times) - 1e6 / SUIT_RATE) > tolerance * 1e6) + 1
    borders = np.concatenate([[0], jumps, [n]])
    pieces = tuple(
        MotionPiece(float(times[first]) / 1e6, SUIT_RATE, joints[first:stop])
        for first, stop in itertools.pairwise(borders)
        if stop - first > shortest * SUIT_RATE
    )
    if not pieces:
        raise InputFileError(path, "timestamps", expected=f"at least {shortest:g} s of steady 240 Hz", found="none")
    return pieces


_HOW_TO_CONVERT = (
    "Give the SMPL neutral model as .npz with plain arrays; prbench opens no pickles. Convert the licensed .pkl once in"
    " the environment of its own tools."
)


def smpl_motion(pieces: tuple[MotionPiece, ...], pose_source: str, head_tilt_deg: float) -> BodyMotion:
    """The fit as a body's motion."""
    return BodyMotion(pieces, pose_source, head_tilt_deg, (), (("bones", str(len(PARENTS) - 1)),))


def _rest_joints(body: dict[str, np.ndarray], betas: np.ndarray) -> np.ndarray:
    """Rest joints of the recording's mean shape."""
    regressor = body["J_regressor"][:N_JOINTS].astype(np.float64)
    shape = betas.reshape(-1, betas.shape[-1]).mean(axis=0)
    directions = body["shapedirs"][..., : len(shape)].astype(np.float64)
    return regressor @ (body["v_template"].astype(np.float64) + directions @ shape)


def _arrays(path: Path, keys: tuple[str, ...], remedy: str) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [key for key in keys if key not in archive.files]
            if missing:
                found = ", ".join(sorted(archive.files))
                raise InputFileError(path, "", expected=f"an array '{missing[0]}'", found=found, remedy=remedy)
            return {key: archive[key] for key in keys}
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="this file", found="no such file", remedy=remedy) from error
    except (ValueError, OSError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise InputFileError(
            path, "", expected="an .npz archive of plain arrays", found=str(error)[:160], remedy=remedy
        ) from error
