"""Bodies of GIMO from fitted parameters or from meshes (docs/specification/gimo.md#three-routes-to-the-22-joints)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.bounded import read_whole
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.readers.egoallo.format import forward_kinematics
from prbench.readers.files import must_exist
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.body_model import PoseDecoder, SmplxModel
from prbench.readers.gimo.pickled_tensors import load_tensors

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
        canonical = _canonical_vertices(files[frame], vertices, faces, model, largest_spread=largest_spread)
        _require_edges(files[frame], canonical, model, largest_edge_error)
        joints[row] = model.regressor @ canonical
        if model.jaw_regressor is not None:
            jaw[row] = model.jaw_regressor @ canonical
    return gimo.LocalJoints(
        np.array(frames, dtype=np.int64), joints, "mesh", jaw if model.jaw_regressor is not None else None
    )


def _canonical_vertices(
    path: Path,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    model: SmplxModel,
    *,
    largest_spread: float,
) -> Float[np.ndarray, "v 3"]:
    """Vertices in the order of the model.

    Raises:
        InputFileError: see :func:`joints_from_meshes`.
    """
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
        raise InputFileError(path, "faces", expected=f"vertices from 1 to {len(vertices)}", found=f"{faces.max() + 1}")
    # Both list the same faces in the same order, so that a corner tells its vertex of the model.
    corners = vertices[faces.ravel()]
    canonical = np.full_like(model.template, np.nan)
    canonical[model.faces.ravel()] = corners
    unhit = int(np.isnan(canonical).any(axis=1).sum())
    if unhit:
        raise InputFileError(path, "faces", expected="every vertex of the model in a face", found=f"{unhit} in none")
    spread = float(np.abs(canonical[model.faces.ravel()] - corners).max(initial=0.0))
    if spread > largest_spread:
        raise InputFileError(
            path,
            "faces",
            expected="faces in the order of the model",
            found=f"vertices on which faces disagree by {spread * 1000:.1f} mm",
            remedy="Use the fitted parameters instead (option vposer_model).",
        )
    return canonical


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
