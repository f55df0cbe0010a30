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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, MissingExtraError
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import N_JOINTS
from prbench.representation.converters.smpl_joints import (
    REGRESSOR,
    SHAPES,
    SMPL_JOINTS,
    SMPLH_JOINTS,
    SMPLX_JOINTS,
    TEMPLATE,
    read_plain_arrays,
)
from prbench.representation.converters.smpl_parameters import SmplParameters

_BODY = (REGRESSOR, TEMPLATE, SHAPES, "posedirs", "weights", "f", "kintree_table")
_HANDS = ("hands_componentsl", "hands_componentsr", "hands_meanl", "hands_meanr")
_FACE = ("lmk_faces_idx", "lmk_bary_coords")
_AT_ONCE = 64  # frames whose surface is held in memory
_MOST_SHAPES = 300  # the package takes as many of them as the model has
_SURFACE_POINTS = (
    "nose", "reye", "leye", "rear", "lear", "LBigToe", "LSmallToe", "LHeel", "RBigToe", "RSmallToe", "RHeel",
)  # fmt: skip
_FINGERS = tuple(f"{side}{finger}" for side in "lr" for finger in ("thumb", "index", "middle", "ring", "pinky"))
_ANY_VERTEX = dict.fromkeys((*_SURFACE_POINTS, *_FINGERS), 0)
"""Surface points that the package appends to the joints; they come behind the 22 and are cut away."""


@dataclass(frozen=True, eq=False)
class SmplxModel:
    """One body model as the package holds it; read it once, it is large."""

    layer: Any
    """``SMPLLayer``, ``SMPLHLayer`` or ``SMPLXLayer``, double precision."""

    @classmethod
    @foreign_input()
    def read(cls, model: Path) -> SmplxModel:
        """The user's own model.

        Args:
            model: SMPL (24 joints), SMPL-H (52) or SMPL-X (55) as ``.npz`` of plain arrays; which one, the file tells.

        Raises:
            MissingExtraError: if ``smplx`` is not installed.
            InputFileError: if the model cannot be read without unpickling, or is another one.
        """
        try:
            import smplx
            import torch
        except ImportError as error:
            raise MissingExtraError("smplx", "smplx", "the SMPL converter through smplx") from error
        arrays = _model_arrays(model)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints warnings, and stdout may belong to a protocol
            return cls(_layer(smplx, torch, arrays))

    def joints(self, parameters: SmplParameters) -> Float[np.ndarray, "frames 22 3"]:
        """Joints as the package computes them; hands and face rest.

        Returns:
            World of the parameters, metres, at their rate.

        Raises:
            InputFileError: if there are more shape numbers than the package takes from this model: 10, or 300 where
                the file has as many.
        """
        import torch

        known = self.layer.num_betas
        betas = np.zeros(known)
        given = np.zeros(0) if parameters.betas is None else parameters.betas
        if np.any(given[known:]):
            raise InputFileError(
                "betas",
                "",
                expected=f"at most {known} shape numbers: the package smplx takes no more from this model",
                found=str(len(given)),
                remedy="smpl_joints takes all that the model has.",
            )
        betas[: len(given[:known])] = given[:known]
        return np.concatenate(
            [
                self._posed(torch, betas, parameters.rotations[first:stop], parameters.transl[first:stop])
                for first, stop in ((first, first + _AT_ONCE) for first in range(0, len(parameters.transl), _AT_ONCE))
            ]
        )

    def _posed(self, torch: Any, betas: np.ndarray, rotations: np.ndarray, transl: np.ndarray) -> np.ndarray:
        frames = len(rotations)
        expressions = getattr(self.layer, "num_expression_coeffs", 0)
        face = {"expression": torch.zeros((frames, expressions), dtype=torch.float64)} if expressions else {}
        turned = torch.from_numpy(_with_resting_hands(rotations, self.layer.NUM_BODY_JOINTS))
        with torch.no_grad():
            posed = self.layer(
                betas=torch.from_numpy(np.tile(betas, (frames, 1))),
                global_orient=turned[:, :1],
                body_pose=turned[:, 1:],
                transl=torch.from_numpy(transl),
                **face,
            )
        return posed.joints[:, :N_JOINTS].numpy()


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


def _layer(smplx: Any, torch: Any, arrays: dict[str, np.ndarray]) -> Any:
    """The package's own model, from numbers alone."""
    from smplx.utils import Struct

    joints = arrays[REGRESSOR].shape[0]
    common = {"dtype": torch.float64, "num_betas": _MOST_SHAPES}
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
    """Rotation matrices of the pelvis and as many body joints as the model has; the hands of SMPL rest."""
    turned = np.tile(np.eye(3), (len(rotations), body_joints + 1, 1, 1))
    from scipy.spatial.transform import Rotation  # late: 0.2 s that whoever only names a converter does not need

    matrices = Rotation.from_quat(rotations.reshape(-1, 4), scalar_first=True).as_matrix()
    turned[:, :N_JOINTS] = matrices.reshape(-1, N_JOINTS, 3, 3)
    return turned
