"""Bodies of GIMO from fitted parameters or from meshes, with the models that the user supplies.

Source: docs/specification/gimo.md#three-routes-to-the-22-joints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import read_whole
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.readers.egoallo.format import forward_kinematics
from prbench.readers.files import missing_file, must_exist
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.pickles import load_tensors

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
    names = (_TEMPLATE, _FACES, _REGRESSOR)
    if not path.exists():
        raise missing_file(path)
    archive = Archive(
        path, remedy=f"Take SMPLX_NEUTRAL.npz of {SMPLX_PAGE}; a .pkl, or arrays of Python objects, are not read."
    )
    archive.require(names)
    arrays = archive.load(names)
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


def read_pose_decoder(path: Path) -> PoseDecoder:
    """Read the decoder of a VPoser v1 snapshot (``snapshots/TR00_E096.pt``), weights only.

    Raises:
        InputFileError: if the file is missing, no file of weights, or those of another network.
    """
    path = path.expanduser()
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
    state = {
        str(name).rpartition("bodyprior_")[1] + str(name).rpartition("bodyprior_")[2]: state[name] for name in state
    }
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


def joints_from_parameters(poses: gimo.SmplxPoses, decoder: PoseDecoder, model: SmplxModel) -> gimo.LocalJoints:
    """The 22 joints of every frame that has parameters; the pelvis is at ``trans`` plus the model's own rest pelvis."""
    rest = model.rest_joints
    local = Rotation.from_matrix(decoder.rotations(poses.latent).reshape(-1, 3, 3)).as_quat(scalar_first=True)
    root = Rotation.from_rotvec(poses.orient.astype(np.float64)).as_quat(scalar_first=True)
    joints = forward_kinematics(
        rest, poses.trans.astype(np.float64) + rest[0], root, local.reshape(len(poses.frames), -1, 4)
    )
    jaw = None
    if model.jaw_regressor is not None:
        # The jaw's own pose is zero in every file, so that it moves with the head.
        offset = model.jaw_regressor @ model.template - rest[Joint.HEAD]
        jaw = joints[:, Joint.HEAD] + _head_rotation(root, local.reshape(len(poses.frames), -1, 4)).apply(offset)
    return gimo.LocalJoints(poses.frames, joints, "smplx", jaw)


def _head_rotation(root: Float[np.ndarray, "n 4"], local: Float[np.ndarray, "n 21 4"]) -> Rotation:
    """Orientation of the head in the suit frame, from those of the joints from the pelvis to it."""
    chain = []
    joint = int(Joint.HEAD)
    while joint > 0:
        chain.append(joint)
        joint = PARENTS[joint]
    head = Rotation.from_quat(root, scalar_first=True)
    for joint in reversed(chain):
        head = head * Rotation.from_quat(local[:, joint - 1], scalar_first=True)
    return head


def joints_from_meshes(
    files: Mapping[int, Path], model: SmplxModel, *, largest_edge_error: float, largest_spread: float
) -> gimo.LocalJoints:
    """The 22 joints of every frame that has a mesh; about 1 cm, more at strongly bent joints.

    Args:
        files: Mesh of each frame, suit frame, metres.
        model: Order of the faces, edge lengths of the rest pose, and regressor.
        largest_edge_error: Metres; mean over the edges of a mesh. Pose changes edges near the joints only.
        largest_spread: Metres within which all faces must agree on where a vertex is.

    Raises:
        InputFileError: if a mesh has another number of vertices or faces than the model, names a vertex that it
            does not have, or its faces are not those of the model.
    """
    frames = sorted(files)
    joints = np.empty((len(frames), len(model.regressor), 3))
    jaw = np.empty((len(frames), 3))
    for row, frame in enumerate(frames):
        vertices, faces = read_obj(files[frame])
        # Vertices in the order of the model.
        path = files[frame]
        for what, found, wanted in (
            ("vertices", len(vertices), len(model.template)),
            ("faces", len(faces), len(model.faces)),
        ):
            if found != wanted:
                raise InputFileError(
                    path,
                    "",
                    expected=f"{wanted} {what}, as the model has them",
                    found=str(found),
                    remedy="This is no mesh of this body model.",
                )
        if faces.min(initial=0) < 0 or faces.max(initial=0) >= len(vertices):
            raise InputFileError(
                path, "faces", expected=f"vertices from 1 to {len(vertices)}", found=f"{faces.max() + 1}"
            )
        # Both list the same faces in the same order, so that a corner tells its vertex of the model.
        corners = vertices[faces.ravel()]
        canonical = np.full_like(model.template, np.nan)
        canonical[model.faces.ravel()] = corners
        unhit = int(np.isnan(canonical).any(axis=1).sum())
        if unhit:
            raise InputFileError(
                path, "faces", expected="every vertex of the model in a face", found=f"{unhit} in none"
            )
        spread = float(np.abs(canonical[model.faces.ravel()] - corners).max(initial=0.0))
        if spread > largest_spread:
            raise InputFileError(
                path,
                "faces",
                expected="faces in the order of the model",
                found=f"vertices on which faces disagree by {spread * 1000:.1f} mm",
                remedy="Use the fitted parameters instead (option vposer_model).",
            )
        _require_edges(files[frame], canonical, model, largest_edge_error)
        joints[row] = model.regressor @ canonical
        if model.jaw_regressor is not None:
            jaw[row] = model.jaw_regressor @ canonical
    return gimo.LocalJoints(
        np.array(frames, dtype=np.int64), joints, "mesh", jaw if model.jaw_regressor is not None else None
    )


def read_obj(path: Path) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Vertices and triangles (counted from 0) of a Wavefront file; everything else in it is skipped.

    Raises:
        InputFileError: if the file is missing, or a line is cut.
    """
    with must_exist(path):
        lines = read_whole(path).splitlines()
    places = [line.split()[1:4] for line in lines if line.startswith(b"v ")]
    corners = [[word.partition(b"/")[0] for word in line.split()[1:]] for line in lines if line.startswith(b"f ")]
    try:
        vertices = np.array(places, dtype=np.float64).reshape(-1, 3)
        faces = np.array(corners, dtype=np.int64).reshape(-1, 3) - 1
    except ValueError as error:
        raise InputFileError(
            path, "", expected="lines 'v x y z' and triangles 'f a b c'", found=str(error), remedy="Copy it again."
        ) from error
    return vertices, faces


def _require_edges(path: Path, vertices: Float[np.ndarray, "v 3"], model: SmplxModel, largest: float) -> None:
    first = model.faces.ravel()
    second = np.roll(model.faces, -1, axis=1).ravel()
    posed, rest = (np.linalg.norm(points[first] - points[second], axis=1) for points in (vertices, model.template))
    error = float(np.abs(posed - rest).mean())
    if error > largest:
        raise InputFileError(
            path,
            "",
            expected=f"edges as long as the model's, within {largest * 1000:.0f} mm on average",
            found=f"{error * 1000:.1f} mm",
            remedy="The mesh is of another shape or unit, or its faces are in another order.",
        )
