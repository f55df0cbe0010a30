"""Bodies of GIMO from fitted parameters, with the models that the user supplies.

Source: docs/specification/gimo.md#two-routes-to-the-22-joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import require, require_size
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.limits import LARGEST_UNPACKED
from prbench.readers.files import missing_file
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.pickles import load_tensors
from prbench.representation.converters.smpl import pose_body

_SLOPE = 0.2  # of the leaky rectifiers
_N_BODY_ROTATIONS = 21
SMPLX_PAGE = "https://smpl-x.is.tue.mpg.de"
VPOSER_PAGE = "https://github.com/nghorbani/human_body_prior (v1.0)"


@dataclass(frozen=True)
class PoseDecoder:
    """The decoding half of VPoser v1: three dense layers and rotations from two columns."""

    weights: tuple[Float[np.ndarray, "_ _"], ...]
    biases: tuple[Float[np.ndarray, " _"], ...]

    def rotations(self, latent: Float[np.ndarray, "n 32"]) -> Float[np.ndarray, "n 21 3 3"]:
        """Return the rotations of the joints 1 to 21 in their parents."""
        values = latent.astype(np.float64)
        for layer in (0, 1):
            values = values @ self.weights[layer].T + self.biases[layer]
            values = np.where(values >= 0, values, _SLOPE * values)
        values = (values @ self.weights[2].T + self.biases[2]).reshape(len(latent), _N_BODY_ROTATIONS, 3, 2)
        # Rotation matrices whose first two columns span the given ones (Gram-Schmidt).
        first = values[..., 0] / np.maximum(np.linalg.norm(values[..., 0], axis=-1, keepdims=True), 1e-12)
        second = values[..., 1] - (first * values[..., 1]).sum(axis=-1, keepdims=True) * first
        second = second / np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-12)
        return np.stack([first, second, np.cross(first, second)], axis=-1)


def read_rest_joints(path: Path) -> Float[np.ndarray, "joints 3"]:
    """Read the joints of SMPL-X neutral's rest pose from ``SMPLX_NEUTRAL.npz``; Python objects in it stay unread.

    Returns:
        Metres, with the mean shape that GIMO gives everybody: 22 or more, of which the 23rd is the jaw.

    Raises:
        InputFileError: if the file is missing, no npz, lacks an array, or the arrays do not fit together.
    """
    path = path.expanduser()
    if not path.exists():
        raise missing_file(path)
    remedy = f"Take SMPLX_NEUTRAL.npz of {SMPLX_PAGE}; a .pkl, or arrays of Python objects, are not read."
    archive = Archive(path, remedy=remedy)
    names = ("v_template", "J_regressor")
    archive.require(names)
    arrays = archive.load(names)
    template, regressor = (arrays[name].astype(np.float64) for name in names)
    fits = template.ndim == 2 and template.shape[1] == 3
    fits = fits and regressor.shape[0] >= N_JOINTS and regressor.shape[1] == len(template)
    expected = "v_template (v, 3) and J_regressor (at least 22, v)"
    require(path, (fits, "", expected, f"{template.shape} and {regressor.shape}", "This is the model of another body."))
    rest = regressor[:N_JOINTS] @ template
    return rest if len(regressor) == N_JOINTS else np.vstack([rest, regressor[N_JOINTS] @ template])


def read_pose_decoder(path: Path) -> PoseDecoder:
    """Read the decoder of a VPoser v1 snapshot (``snapshots/TR00_E096.pt``), weights only.

    Raises:
        InputFileError: if the file is missing, no file of weights, or those of another network.
    """
    path = path.expanduser()
    import torch

    if not path.exists():
        raise missing_file(path)
    require_size(path, largest=LARGEST_UNPACKED)
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever a damaged archive makes it stumble over
        found = str(error).splitlines()[0][:200]
        remedy = f"Take snapshots/TR00_E096.pt of VPoser v1: {VPOSER_PAGE}."
        raise InputFileError(path, "", expected="a file of weights", found=found, remedy=remedy) from error
    # Snapshots of a whole training hold the weights one level deeper.
    for wrapper in ("state_dict", "model_state_dict"):
        state = state[wrapper] if isinstance(state, Mapping) and wrapper in state else state
    require(path, (isinstance(state, Mapping), "", "named weights", type(state).__name__, ""))
    state = {str(name)[max(str(name).find("bodyprior_"), 0) :]: values for name, values in state.items()}
    layers = ("bodyprior_dec_fc1", "bodyprior_dec_fc2", "bodyprior_dec_out")
    names = [f"{layer}.{part}" for layer in layers for part in ("weight", "bias")]
    present = ", ".join(list(state)[:6]) or "nothing"
    remedy = f"GIMO was fitted with VPoser v1, not v2: {VPOSER_PAGE}."
    require(path, *((name in state, "", f"the weights '{name}'", present, remedy) for name in names))
    arrays = [state[name].detach().cpu().numpy().astype(np.float64) for name in names]
    weights = tuple(arrays[::2])
    biases = tuple(arrays[1::2])
    width = _N_BODY_ROTATIONS * 6
    fits = (
        all(weight.ndim == 2 for weight in weights)
        and weights[0].shape[1] == gimo.N_LATENT
        and weights[2].shape[0] == width
        and all(weight.shape[0] == bias.size for weight, bias in zip(weights, biases, strict=True))
        and weights[1].shape == (weights[2].shape[1], weights[0].shape[0])
    )
    found = ", ".join(str(weight.shape) for weight in weights)
    require(path, (fits, "", f"layers from {gimo.N_LATENT} to {width} numbers", found, remedy))
    return PoseDecoder(weights, biases)


_SIZES = {"orient": 3, "trans": 3, "latent": gimo.N_LATENT}
_SHAPE_KEYS = ("beta", "expression")


def read_poses(files: Mapping[int, Path]) -> gimo.SmplxPoses:
    """Read the parameters of all frames that have a file, in the order of the frames.

    Raises:
        InputFileError: if a file is damaged, names foreign classes, lacks a key, or has another size or NaN in it.
    """
    frames = sorted(files)
    columns: dict[str, list[np.ndarray]] = {key: [] for key in _SIZES}
    for frame in frames:
        path = files[frame]
        tensors = load_tensors(path)
        for key, size in _SIZES.items():
            require(path, (key in tensors, "", f"the key '{key}'", ", ".join(sorted(tensors)) or "no keys", ""))
            values = tensors[key].astype(np.float32).ravel()
            require(
                path,
                (values.size == size, key, f"{size} numbers", values.size, "It belongs to another format."),
                (np.isfinite(values).all(), key, "finite numbers", "NaN", "Copy the file again."),
            )
            columns[key].append(values)
        for key in _SHAPE_KEYS:
            is_mean = key not in tensors or not np.abs(tensors[key]).max(initial=0.0) > 0
            remedy = "Joints of another shape cannot be computed from this format's constants."
            expected = "zeros: everybody is fitted with the neutral mean shape"
            require(path, (is_mean, key, expected, "other numbers", remedy))
    arrays = {key: np.array(columns[key], dtype=np.float32).reshape(-1, size) for key, size in _SIZES.items()}
    return gimo.SmplxPoses(np.array(frames, dtype=np.int64), **arrays)


def joints_from_parameters(
    poses: gimo.SmplxPoses, decoder: PoseDecoder, rest: Float[np.ndarray, "joints 3"]
) -> gimo.LocalJoints:
    """Return the 22 joints, and the jaw, of every frame that has parameters.

    Args:
        poses: The pelvis is at ``trans`` plus the model's own rest pelvis.
        decoder: Turns ``latent`` into rotations.
        rest: See :func:`read_rest_joints`.
    """
    local = Rotation.from_matrix(decoder.rotations(poses.latent).reshape(-1, 3, 3)).as_quat(scalar_first=True)
    root = Rotation.from_rotvec(poses.orient.astype(np.float64)).as_quat(scalar_first=True)
    rotations = np.concatenate([root[:, None], local.reshape(len(root), -1, 4)], axis=1)
    joints, turned = pose_body(rest[:N_JOINTS], poses.trans.astype(np.float64) + rest[0], rotations)
    jaw = None
    if len(rest) > N_JOINTS:
        # The jaw's own pose is zero in every file, so that it moves with the head.
        jaw = joints[:, Joint.HEAD] + turned[:, Joint.HEAD] @ (rest[N_JOINTS] - rest[Joint.HEAD])
    return gimo.LocalJoints(poses.frames, joints, jaw)
