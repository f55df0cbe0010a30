"""The 22 joints through the package ``smplx`` (extra ``prbench[smplx]``), with the user's own model file.

:func:`prbench.representation.converters.smpl_joints` gives the same joints without it and without torch; this is the
second opinion, and the way for whoever needs the package's own model classes anyway. The package opens ``.pkl`` files
with pickle and ``.npz`` files with ``allow_pickle=True``; here it never sees the user's file, only arrays of numbers
that were read from it.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, MissingExtraError
from prbench.representation.converters.smpl.body_model import (
    REGRESSOR,
    SHAPES,
    SMPL_JOINTS,
    SMPLH_JOINTS,
    SMPLX_JOINTS,
    TEMPLATE,
    read_plain_arrays,
)
from prbench.representation.converters.smpl.parameters import SmplParameters
from prbench.skeleton import N_JOINTS

_BODY = (REGRESSOR, TEMPLATE, SHAPES, "posedirs", "weights", "f", "kintree_table")
_HANDS = ("hands_componentsl", "hands_componentsr", "hands_meanl", "hands_meanr")
_FACE = ("lmk_faces_idx", "lmk_bary_coords")
_ROWS_AT_ONCE = 64  # frames whose surface is held in memory
_SURFACE_POINTS = (
    "nose",
    "reye",
    "leye",
    "rear",
    "lear",
    "LBigToe",
    "LSmallToe",
    "LHeel",
    "RBigToe",
    "RSmallToe",
    "RHeel",
)
_FINGERS = tuple(f"{side}{finger}" for side in "lr" for finger in ("thumb", "index", "middle", "ring", "pinky"))
_ANY_VERTEX = dict.fromkeys((*_SURFACE_POINTS, *_FINGERS), 0)
"""Surface points that the package appends to the joints; they come behind the 22 and are cut away."""


def joints_by_smplx(parameters: SmplParameters, model: Path) -> Float[np.ndarray, "frames 22 3"]:
    """Joints as the package computes them, in double precision.

    Args:
        parameters: The motion; hands and face rest.
        model: SMPL (24 joints), SMPL-H (52) or SMPL-X (55) as ``.npz`` of plain arrays; which one, the file tells.

    Returns:
        World of the parameters, metres, at their rate.

    Raises:
        MissingExtraError: if ``smplx`` is not installed.
        InputFileError: if the model cannot be read without unpickling, is another one, or has fewer shape numbers
            than the package would use.
    """
    try:
        import smplx
        import torch
    except ImportError as error:
        raise MissingExtraError("smplx", "smplx", "the SMPL converter through smplx") from error

    arrays = _model_arrays(model)
    betas = np.zeros(10) if parameters.betas is None else parameters.betas
    with contextlib.redirect_stdout(io.StringIO()):  # it prints warnings, and stdout may belong to a protocol
        layer = _layer(smplx, torch, arrays, n_betas=len(betas))
    if np.any(betas[layer.num_betas :]):
        raise InputFileError(
            "betas",
            "",
            expected=f"at most {layer.num_betas} shape numbers: smplx takes no more from this model",
            found=str(len(betas)),
            remedy="smpl_joints takes all that the model has.",
        )
    shape = torch.from_numpy(betas[None, : layer.num_betas].copy())
    rotations = _with_resting_hands(parameters.rotations, layer.NUM_BODY_JOINTS)
    joints = []
    for start in range(0, len(rotations), _ROWS_AT_ONCE):
        turned = torch.from_numpy(rotations[start : start + _ROWS_AT_ONCE])
        moved = torch.from_numpy(parameters.transl[start : start + _ROWS_AT_ONCE])
        with torch.no_grad():
            posed = layer(
                betas=shape.expand(len(turned), -1),
                global_orient=turned[:, :1],
                body_pose=turned[:, 1:],
                transl=moved,
                **_resting(torch, arrays, len(turned), layer),
            )
        joints.append(posed.joints[:, :N_JOINTS].numpy())
    return np.concatenate(joints)


def _model_arrays(model: Path) -> dict[str, np.ndarray]:
    arrays = read_plain_arrays(model, _BODY, (*_HANDS, *_FACE))
    joints = arrays[REGRESSOR].shape[0] if arrays[REGRESSOR].ndim == 2 else 0
    needed = {SMPL_JOINTS: (), SMPLH_JOINTS: _HANDS, SMPLX_JOINTS: (*_HANDS, *_FACE)}
    if joints not in needed:
        raise InputFileError(
            model,
            REGRESSOR,
            expected="a regressor of 24 (SMPL), 52 (SMPL-H) or 55 (SMPL-X) joints",
            found=str(arrays[REGRESSOR].shape),
        )
    missing = [name for name in needed[joints] if name not in arrays]
    if missing:
        raise InputFileError(
            model,
            "",
            expected=f"an array '{missing[0]}', which smplx wants of a model of {joints} joints",
            found="none",
            remedy="smpl_joints needs no hands and no face.",
        )
    return arrays


def _layer(smplx: Any, torch: Any, arrays: dict[str, np.ndarray], *, n_betas: int) -> Any:
    """The package's own model, from numbers alone."""
    from smplx.utils import Struct

    joints = arrays[REGRESSOR].shape[0]
    common = {"dtype": torch.float64, "num_betas": n_betas}
    if joints == SMPLX_JOINTS:  # this class takes no arrays, only a file: one that holds nothing but numbers
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / "numbers.npz"
            np.savez(plain, allow_pickle=False, **arrays)
            return smplx.SMPLXLayer(str(plain), ext="npz", use_pca=False, **common)
    given = {"data_struct": Struct(**arrays), "vertex_ids": _ANY_VERTEX, **common}
    if joints == SMPLH_JOINTS:
        return smplx.SMPLHLayer("", use_pca=False, **given)
    return smplx.SMPLLayer("", **given)


def _with_resting_hands(rotations: np.ndarray, body_joints: int) -> np.ndarray:
    """Rotations of the pelvis and as many body joints as the model has; the hands of SMPL rest."""
    turned = np.tile(np.eye(3), (len(rotations), body_joints + 1, 1, 1))
    turned[:, :N_JOINTS] = rotations
    return turned


def _resting(torch: Any, arrays: dict[str, np.ndarray], frames: int, layer: Any) -> dict[str, Any]:
    """Arguments that the package would otherwise make in another precision."""
    if arrays[REGRESSOR].shape[0] != SMPLX_JOINTS:
        return {}
    return {"expression": torch.zeros((frames, layer.num_expression_coeffs), dtype=torch.float64)}
