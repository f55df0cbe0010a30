"""SMPL, SMPL-H and SMPL-X: the parameters of the user's own body model that come nearest to the 22 joints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from prbench.errors import UsageError
from prbench.files.arrays import Archive
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint, bone_lengths
from prbench.representation.converters.smpl import REGRESSOR, from_axis_angle, pose_body, read_rest_joints
from prbench.viewing.exporting.skeleton import pose_skeleton
from prbench.viewing.replay.scene import Scene

if TYPE_CHECKING:
    from prbench.viewing.exporting.export import ExportRequest

_SHAPES = 10  # numbers of the shape that are fitted
_SHAPE_WEIGHT = 0.002  # metres that one deviation of a shape number is worth
_STEPS = 60
# Smallest and largest rotation vectors in the model's frame (x left, y up, z forward, arms to the sides), radians. Our
# own reading of how far people bend, not fitted to any data: positions leave twists open, and these bound them.
_LIMITS = {
    "hip": ((-2.4, -0.8, -0.9), (0.8, 0.8, 0.9)),
    "knee": ((-0.1, -0.3, -0.2), (2.6, 0.3, 0.2)),
    "ankle": ((-0.9, -0.5, -0.5), (0.9, 0.5, 0.5)),
    "foot": ((-0.8, -0.3, -0.3), (0.8, 0.3, 0.3)),
    "spine": ((-0.5, -0.6, -0.5), (1.0, 0.6, 0.5)),
    "neck": ((-0.8, -1.0, -0.7), (0.9, 1.0, 0.7)),
    "collar": ((-0.4, -0.5, -0.6), (0.4, 0.5, 0.6)),
    "shoulder": ((-1.8, -2.2, -2.0), (1.8, 2.2, 2.0)),
    "elbow": ((-1.6, -2.6, -0.4), (1.6, 0.1, 0.4)),  # the left one: it bends about -y
}
_NO_ANGLE = 1e-12  # squared radians
_LIMIT_WEIGHT = 0.02  # square metres a square radian beyond a limit


def write(scene: Scene, path: Path, about: dict[str, Any], request: ExportRequest) -> Float[np.ndarray, "n 22"]:
    """Fit a body model to the first motion of a scene; write its parameters as AMASS does, but Y up.

    The shape is the one whose bones are nearest in length. Rotations are first solved from it joint by joint, then
    moved until limits of the joints hold. Hands and face stay in rest.

    Args:
        scene: The sequence.
        path: The file.
        about: What is said of the motion, written as JSON.
        request: Names the body model; see :func:`prbench.representation.converters.smpl.read_rest_joints`.

    Returns:
        Distance of each joint of the fitted body from the motion, metres.

    Raises:
        UsageError: if no body model is named.
        InputFileError: if it cannot be read.
    """
    joints = scene.motions[0].joints
    body_model = request.body_model
    if body_model is None:
        raise UsageError("--format smpl: name your own copy of SMPL, SMPL-H or SMPL-X with --body-model FILE.npz.")
    model = read_rest_joints(body_model)
    n_joints = len(Archive(body_model.expanduser()).load([REGRESSOR])[REGRESSOR])
    # The shape whose bones are nearest to the mean ones in length; unlikely bodies cost.
    lengths = bone_lengths(joints.astype(np.float64)).mean(axis=0)
    betas = np.zeros(min(_SHAPES, model.directions.shape[-1]))

    def residual(betas: np.ndarray) -> np.ndarray:
        return np.concatenate([bone_lengths(model.of(betas)) - lengths, _SHAPE_WEIGHT * betas])

    if len(betas):
        betas = least_squares(residual, betas).x
    rest = model.of(betas)
    vectors, pelvis = _fit_pose(joints, rest)
    fitted, _ = pose_body(rest, pelvis, from_axis_angle(vectors))
    error = np.linalg.norm(fitted - joints, axis=2)
    poses = np.zeros((len(joints), n_joints * 3))
    poses[:, : N_JOINTS * 3] = vectors.reshape(len(joints), -1)
    rate = np.array(scene.fps)
    arrays = {
        "poses": poses, "trans": pelvis - rest[Joint.PELVIS], "betas": betas, "gender": np.array("neutral"),
        "mocap_framerate": rate, "mocap_frame_rate": rate, "error": error,
        "about": np.array(msgspec.json.encode(about, order="sorted").decode()),
    }  # fmt: skip
    with open(path, "wb") as file:
        np.savez(file, **arrays)
    return error


def _fit_pose(
    joints: Float[np.ndarray, "n 22 3"], rest: Float[np.ndarray, "22 3"]
) -> tuple[Float[np.ndarray, "n 22 3"], Float[np.ndarray, "n 3"]]:
    """Return rotation vectors of the joints, of the pelvis in the world, and the pelvis's places."""
    offsets = rest - rest[list(PARENTS)]
    local = pose_skeleton(joints, offsets).local
    start = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(joints.shape)
    low = np.full((N_JOINTS, 3), -np.inf)
    high = -low
    for joint in Joint:
        side, _, part = joint.name.lower().rpartition("_")
        limits = _LIMITS.get(part.rstrip("123"))
        if limits is not None:
            low[joint], high[joint] = limits
        if side == "right":  # the mirror image turns about y and z the other way round
            low[joint, 1:], high[joint, 1:] = -high[joint, 1:], -low[joint, 1:]
    lowest, highest, bones, wanted = (torch.from_numpy(each) for each in (low, high, offsets, joints.astype(float)))
    vectors = torch.from_numpy(start.copy()).requires_grad_()
    pelvis = wanted[:, 0].clone().requires_grad_()
    optimizer = torch.optim.LBFGS([vectors, pelvis], max_iter=_STEPS, line_search_fn="strong_wolfe")

    def loss() -> torch.Tensor:
        optimizer.zero_grad()
        turns = _matrices(vectors)
        places = [pelvis]
        world = [turns[:, 0]]
        for joint in range(1, N_JOINTS):
            before = world[PARENTS[joint]]
            places.append(places[PARENTS[joint]] + before @ bones[joint])
            world.append(before @ turns[:, joint])
        beyond = (vectors - highest).clamp(min=0) + (lowest - vectors).clamp(min=0)
        total = (torch.stack(places, 1) - wanted).square().sum() + _LIMIT_WEIGHT * beyond.square().sum()
        total.backward()
        return total

    optimizer.step(loss)  # pyright: ignore[reportArgumentType]
    return vectors.detach().numpy(), pelvis.detach().numpy()


def _matrices(vectors: torch.Tensor) -> torch.Tensor:
    """Return the rotation matrices (…, 3, 3) of rotation vectors (…, 3)."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    angle = (vectors.square().sum(-1) + _NO_ANGLE)[..., None, None].sqrt()  # a root of zero has no gradient
    eye = torch.eye(3, dtype=vectors.dtype)
    return eye + angle.sin() / angle * cross + (1 - angle.cos()) / angle.square() * (cross @ cross)
