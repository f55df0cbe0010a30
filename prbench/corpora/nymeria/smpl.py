"""The SMPL fit of the Plus release, posed with the user's own body model.

Source: docs/specification/nymeria.md#the-22-joints.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from prbench.corpora.nymeria.body import BodyMotion, MotionPiece
from prbench.corpora.nymeria.format import SUIT_RATE
from prbench.errors import InputFileError
from prbench.numpy_files import Archive
from prbench.representation.converters import SmplParameters, read_rest_joints, smpl_joints
from prbench.skeleton import PARENTS

_FIT_KEYS = ("betas", "body_pose", "global_orient", "transl", "timestamps")


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
    fit = _arrays(path)
    n = len(fit["transl"])
    shapes = {"body_pose": (n, 69), "global_orient": (n, 3), "transl": (n, 3), "timestamps": (n,)}
    for key, shape in shapes.items():
        if fit[key].shape != shape or not np.isfinite(fit[key]).all():
            raise InputFileError(path, key, expected=f"finite numbers of the shape {shape}", found=str(fit[key].shape))
    parameters = SmplParameters.from_arrays(
        global_orient=fit["global_orient"],
        body_pose=fit["body_pose"],
        transl=fit["transl"],
        betas=fit["betas"],
        source=path,
    )
    joints = smpl_joints(parameters, read_rest_joints(model))
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


def smpl_motion(pieces: tuple[MotionPiece, ...], pose_source: str, head_tilt_deg: float) -> BodyMotion:
    """The fit as a body's motion."""
    return BodyMotion(pieces, pose_source, head_tilt_deg, (), (("bones", str(len(PARENTS) - 1)),))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    archive = Archive(path)
    archive.require(_FIT_KEYS)
    return archive.load(_FIT_KEYS)
