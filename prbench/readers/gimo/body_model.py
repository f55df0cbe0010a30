"""SMPL-X and VPoser files that the user supplies: the few arrays of them that joints need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.geometry.skeleton import N_JOINTS
from prbench.readers.files import missing_file
from prbench.readers.gimo import format as gimo

_REGRESSOR = "J_regressor"
_TEMPLATE = "v_template"
_FACES = "f"
_SLOPE = 0.2  # of the leaky rectifiers
_N_BODY_ROTATIONS = 21
SMPLX_PAGE = "https://smpl-x.is.tue.mpg.de"
VPOSER_PAGE = "https://github.com/nghorbani/human_body_prior (v1.0)"


@dataclass(frozen=True)
class SmplxModel:
    """SMPL-X neutral in its rest pose, with the mean shape that GIMO gives everybody."""

    template: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    regressor: Float[np.ndarray, "22 v"]
    """Joints as weighted vertices: the first 22 of the model's 55."""
    jaw_regressor: Float[np.ndarray, " v"] | None = None
    """Weights of the jaw, the model's next joint; None where the file holds no more than 22."""

    @property
    def rest_joints(self) -> Float[np.ndarray, "22 3"]:
        """Joints of the rest pose, metres."""
        return self.regressor @ self.template


@dataclass(frozen=True)
class PoseDecoder:
    """The decoding half of VPoser v1: three dense layers and rotations from two columns."""

    weights: tuple[Float[np.ndarray, "out1 in1"], Float[np.ndarray, "out2 in2"], Float[np.ndarray, "out3 in3"]]
    biases: tuple[Float[np.ndarray, " out1"], Float[np.ndarray, " out2"], Float[np.ndarray, " out3"]]

    def rotations(self, latent: Float[np.ndarray, "n 32"]) -> Float[np.ndarray, "n 21 3 3"]:
        """Rotations of the joints 1 to 21 in their parents."""
        values = latent.astype(np.float64)
        for layer in (0, 1):
            values = values @ self.weights[layer].T + self.biases[layer]
            values = np.where(values >= 0, values, _SLOPE * values)
        values = values @ self.weights[2].T + self.biases[2]
        return _from_two_columns(values.reshape(len(latent), _N_BODY_ROTATIONS, 3, 2))


_LAYERS = ("bodyprior_dec_fc1", "bodyprior_dec_fc2", "bodyprior_dec_out")


def read_smplx_model(path: Path) -> SmplxModel:
    """Read ``SMPLX_NEUTRAL.npz``; arrays that hold Python objects stay unread.

    Raises:
        InputFileError: if the file is missing, no npz, lacks an array, or the arrays do not fit together.
    """
    path = path.expanduser()
    arrays = _arrays(path, (_TEMPLATE, _FACES, _REGRESSOR))
    template = arrays[_TEMPLATE]
    faces = arrays[_FACES].astype(np.int64)
    regressor = arrays[_REGRESSOR]
    fits = template.ndim == 2 and template.shape[1] == 3 and faces.ndim == 2 and faces.shape[1] == 3
    if not fits or regressor.shape[0] < N_JOINTS or regressor.shape[1] != len(template):
        raise InputFileError(
            path,
            "",
            expected="v_template (v, 3), f (f, 3) and J_regressor (at least 22, v)",
            found=f"{template.shape}, {faces.shape} and {regressor.shape}",
            remedy="This is the model of another body.",
        )
    regressor = regressor.astype(np.float64)
    jaw = regressor[N_JOINTS] if len(regressor) > N_JOINTS else None
    return SmplxModel(template.astype(np.float64), faces, regressor[:N_JOINTS], jaw)


def _arrays(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    if not path.exists():
        raise missing_file(path)
    archive = Archive(
        path, remedy=f"Take SMPLX_NEUTRAL.npz of {SMPLX_PAGE}; a .pkl, or arrays of Python objects, are not read."
    )
    archive.require(names)
    return archive.load(names)


def read_pose_decoder(path: Path) -> PoseDecoder:
    """Read the decoder of a VPoser v1 snapshot (``snapshots/TR00_E096.pt``), weights only.

    Raises:
        InputFileError: if the file is missing, no file of weights, or those of another network.
    """
    path = path.expanduser()
    state = _state(path)
    weights = []
    biases = []
    for layer in _LAYERS:
        weights.append(_tensor(path, state, f"{layer}.weight"))
        biases.append(_tensor(path, state, f"{layer}.bias"))
    fits = (
        weights[0].ndim == 2
        and weights[0].shape[1] == gimo.N_LATENT
        and weights[2].shape[0] == _N_BODY_ROTATIONS * 6
        and all(weight.shape[0] == bias.size for weight, bias in zip(weights, biases, strict=True))
        and weights[1].shape == (weights[2].shape[1], weights[0].shape[0])
    )
    if not fits:
        raise InputFileError(
            path,
            "",
            expected=f"layers from {gimo.N_LATENT} to {_N_BODY_ROTATIONS * 6} numbers",
            found=", ".join(str(weight.shape) for weight in weights),
            remedy=f"GIMO was fitted with VPoser v1: {VPOSER_PAGE}.",
        )
    return PoseDecoder((weights[0], weights[1], weights[2]), (biases[0], biases[1], biases[2]))


def _state(path: Path) -> Mapping[str, Any]:
    import torch

    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except Exception as error:  # torch raises whatever a damaged archive makes it stumble over
        raise InputFileError(
            path,
            "",
            expected="a file of weights",
            found=str(error).splitlines()[0][:200],
            remedy=f"Take snapshots/TR00_E096.pt of VPoser v1: {VPOSER_PAGE}.",
        ) from error
    # Snapshots of a whole training hold the weights one level deeper.
    for wrapper in ("state_dict", "model_state_dict"):
        state = state[wrapper] if isinstance(state, Mapping) and wrapper in state else state
    if not isinstance(state, Mapping):
        raise InputFileError(path, "", expected="named weights", found=type(state).__name__)
    return {
        str(name).rpartition("bodyprior_")[1] + str(name).rpartition("bodyprior_")[2]: state[name] for name in state
    }


def _tensor(path: Path, state: Mapping[str, Any], name: str) -> np.ndarray:
    if name not in state:
        raise InputFileError(
            path,
            "",
            expected=f"the weights '{name}'",
            found=", ".join(list(state)[:6]) or "nothing",
            remedy=f"GIMO was fitted with VPoser v1, not v2: {VPOSER_PAGE}.",
        )
    return state[name].detach().cpu().numpy().astype(np.float64)


def _from_two_columns(values: Float[np.ndarray, "n 21 3 2"]) -> Float[np.ndarray, "n 21 3 3"]:
    """Rotation matrices whose first two columns span the given ones (Gram-Schmidt)."""
    first = values[..., 0] / np.maximum(np.linalg.norm(values[..., 0], axis=-1, keepdims=True), 1e-12)
    second = values[..., 1] - (first * values[..., 1]).sum(axis=-1, keepdims=True) * first
    second = second / np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-12)
    return np.stack([first, second, np.cross(first, second)], axis=-1)
