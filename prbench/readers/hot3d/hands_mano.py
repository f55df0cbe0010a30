"""MANO hands: poses line by line, posed by the licensed model that the user brings.

Source: docs/specification/hot3d.md#files.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.hands_umetrack import Wrist, hand_rows, read_lines
from prbench.readers.hot3d.layout import MANO, MANO_MODEL_PREFIX
from prbench.recording.streams import Side

N_VERTICES = 778
N_JOINTS = 16
N_BETAS = 10
N_COEFFICIENTS = 15
_MODEL_KEYS = (
    "v_template",
    "shapedirs",
    "posedirs",
    "weights",
    "J_regressor",
    "kintree_table",
    "hands_components",
    "hands_mean",
    "f",
)


@dataclass(frozen=True)
class ManoModel:
    """One hand of the model; metres."""

    template: Float[np.ndarray, "v 3"]
    shape_directions: Float[np.ndarray, "v 3 10"]
    pose_directions: Float[np.ndarray, "v 3 135"]
    weights: Float[np.ndarray, "v 16"]
    regressor: Float[np.ndarray, "16 v"]
    parents: Int[np.ndarray, "16"]
    """-1 of the root."""
    components: Float[np.ndarray, "15 45"]
    """The first 15 principal poses."""
    mean_pose: Float[np.ndarray, "45"]
    """Rotation vectors of the 15 finger joints."""


_CONVERT = (
    "prbench opens no pickles. Convert each MANO_*.pkl once, in an environment that you trust with it: "
    "`python -c \"import pickle, numpy as np; m = pickle.load(open('MANO_LEFT.pkl', 'rb'), encoding='latin1'); "
    "np.savez('MANO_LEFT.npz', **{k: np.array(m[k].todense() if hasattr(m[k], 'todense') else m[k]) "
    f"for k in '{' '.join(_MODEL_KEYS)}'.split()}})\"`"
)
_SHAPES: dict[str, tuple[int, ...]] = {
    "v_template": (N_VERTICES, 3),
    "shapedirs": (N_VERTICES, 3, N_BETAS),
    "posedirs": (N_VERTICES, 3, 135),
    "weights": (N_VERTICES, N_JOINTS),
    "J_regressor": (N_JOINTS, N_VERTICES),
    "kintree_table": (2, N_JOINTS),
    "hands_components": (45, 45),
    "hands_mean": (45,),
}


class _ManoHand(msgspec.Struct):
    wrist_xform: Wrist
    pose: list[float]
    betas: list[float]


class _ManoLine(msgspec.Struct):
    timestamp_ns: int
    hand_poses: dict[str, _ManoHand]


_DECODER = msgspec.json.Decoder(_ManoLine)


def read_mano_hands(found: RecordingFiles, folder: Path | None) -> tuple[tuple[hot3d.HandPoints, ...], tuple[str, ...]]:
    """Wrists and vertices of both hands, and remarks.

    Args:
        found: The recording's files, the models among them.
        folder: Where the user said that the models are, for the message.

    Raises:
        InputFileError: if the poses or a model are missing or damaged.
    """
    path = found.require(MANO, hot3d.MANO_FILE)
    hands, remarks = read_mano_rows(path)
    models = _read_models(found, folder)
    points = []
    for rows in hands:
        wrist, vertices = pose_hand(models[rows.side], rows.betas, rows.angles, rows.rotation, rows.position)
        points.append(hot3d.HandPoints(rows.side, rows.time_ns, wrist, vertices))
    return tuple(points), remarks


def read_mano_rows(path: Path) -> tuple[tuple[hot3d.HandRows, ...], tuple[str, ...]]:
    """Both hands over time as the file has them, and remarks; one shape holds for the whole recording.

    Raises:
        InputFileError: if the file is missing or holds no line at all, a pose is no pose, or time runs backwards.
    """
    lines, remarks = read_lines(path, _DECODER)
    hands = []
    for side, key in hot3d.HAND_KEYS.items():
        rows = [(line.timestamp_ns, line.hand_poses[key]) for line in lines if key in line.hand_poses]
        angles = np.zeros((len(rows), N_COEFFICIENTS))
        for row, (time, hand) in enumerate(rows):
            if len(hand.pose) != N_COEFFICIENTS or len(hand.betas) != N_BETAS:
                found = f"{len(hand.pose)} and {len(hand.betas)}"
                raise InputFileError(path, f"{side} hand at {time} ns", expected="15 and 10 numbers", found=found)
            angles[row] = hand.pose
        betas = np.array(rows[0][1].betas) if rows else np.zeros(N_BETAS)
        hands.append(hand_rows(path, side, [(time, hand.wrist_xform) for time, hand in rows], angles, betas))
    return tuple(hands), remarks


def _read_models(found: RecordingFiles, folder: Path | None) -> dict[Side, ManoModel]:
    """Both hands of the licensed model.

    Raises:
        InputFileError: if one is missing (saying how to convert it) or damaged.
    """
    models: dict[Side, ManoModel] = {}
    for side in hot3d.HAND_KEYS:
        path = found.path(f"{MANO_MODEL_PREFIX}{side}")
        name = f"MANO_{side.upper()}.npz"
        if path is None:
            raise InputFileError(
                (folder or Path("mano")).expanduser() / name,
                "",
                expected="the licensed MANO model as arrays (option mano_models=FOLDER)",
                found="no such file" if folder is not None else "no folder was given",
                remedy=f"{_CONVERT}, and the same for MANO_RIGHT. Without MANO use hands=umetrack.",
            )
        models[side] = _read_model(path)
    models["left"] = without_left_hand_bug(models["left"], models["right"])
    return models


def _read_model(path: Path) -> ManoModel:
    archive = Archive(path, remedy=_CONVERT)
    archive.require(_SHAPES)
    arrays = archive.load(_SHAPES)
    for name, shape in _SHAPES.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "fiu":
            found = f"{arrays[name].shape} of {arrays[name].dtype}"
            raise InputFileError(path, name, expected=f"numbers of the shape {shape}", found=found, remedy=_CONVERT)
    parents = arrays["kintree_table"][0].astype(np.int64)
    parents[0] = -1
    if not (parents[1:] < np.arange(1, N_JOINTS)).all() or (parents[1:] < 0).any():
        raise InputFileError(path, "kintree_table", expected="parents before children", found=str(parents.tolist()))
    wide = {name: array.astype(np.float64) for name, array in arrays.items()}
    return ManoModel(
        template=wide["v_template"],
        shape_directions=wide["shapedirs"],
        pose_directions=wide["posedirs"],
        weights=wide["weights"],
        regressor=wide["J_regressor"],
        parents=parents,
        components=wide["hands_components"][:N_COEFFICIENTS],
        mean_pose=wide["hands_mean"],
    )


def without_left_hand_bug(left: ManoModel, right: ManoModel) -> ManoModel:
    """The left hand with its shape directions mirrored in x, where the file holds those of the right hand.

    The model's first release has this mistake (smplx issue 48); HOT3D's hands were fitted without it.
    """
    if np.abs(left.shape_directions[:, 0] - right.shape_directions[:, 0]).sum() >= 1:
        return left
    return replace(left, shape_directions=left.shape_directions * np.array([-1.0, 1.0, 1.0])[:, None])


def pose_hand(
    model: ManoModel,
    betas: Float[np.ndarray, "10"],
    coefficients: Float[np.ndarray, "n 15"],
    rotation: Float[np.ndarray, "n 4"],
    translation: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n v 3"]]:
    """Wrist and vertices in the world.

    Args:
        model: The hand.
        betas: Shape.
        coefficients: Of the principal poses, added to the mean pose.
        rotation: Of the root joint, w x y z.
        translation: Added to everything, metres.
    """
    shaped = model.template + model.shape_directions @ betas
    joints = model.regressor @ shaped
    n = len(rotation)
    fingers = (model.mean_pose + coefficients @ model.components).reshape(-1, 3)
    local = np.empty((n, N_JOINTS, 3, 3))
    local[:, 0] = Rotation.from_quat(rotation, scalar_first=True).as_matrix().reshape(n, 3, 3)
    local[:, 1:] = Rotation.from_rotvec(fingers).as_matrix().reshape(n, N_JOINTS - 1, 3, 3)
    # Corrections of the shape are linear in the rotations minus the identity; the root has none.
    bend = (local[:, 1:] - np.eye(3)).reshape(n, -1)
    posed = shaped + np.einsum("vci,ni->nvc", model.pose_directions, bend, optimize=True)
    turn, shift = _joint_transforms(model.parents, joints, local)
    blended_turn = np.einsum("vj,njab->nvab", model.weights, turn, optimize=True)
    vertices = np.einsum("nvab,nvb->nva", blended_turn, posed) + model.weights @ shift
    return joints[0] + translation, vertices + translation[:, None]


def _joint_transforms(
    parents: Int[np.ndarray, "16"], joints: Float[np.ndarray, "16 3"], local: Float[np.ndarray, "n 16 3 3"]
) -> tuple[Float[np.ndarray, "n 16 3 3"], Float[np.ndarray, "n 16 3"]]:
    """Rotation and shift of every joint against its rest: ``x -> turn x + shift``."""
    turn = np.empty_like(local)
    place = np.empty(local.shape[:3])
    turn[:, 0] = local[:, 0]
    place[:, 0] = joints[0]
    for joint in range(1, N_JOINTS):
        parent = parents[joint]
        turn[:, joint] = turn[:, parent] @ local[:, joint]
        place[:, joint] = place[:, parent] + turn[:, parent] @ (joints[joint] - joints[parent])
    # x -> turn (x - joint) + place, so that the shift is place - turn joint.
    return turn, place - np.einsum("njab,jb->nja", turn, joints)
