"""MANO hands: poses line by line, posed by the licensed model that the user brings.

Source: docs/specification/hot3d.md#files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from prbench.errors import InputFileError
from prbench.numpy_files import Archive
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import mano
from prbench.readers.hot3d.hands_umetrack import hand_rows, read_lines
from prbench.readers.hot3d.layout import MANO, MANO_MODEL_PREFIX

_CONVERT = (
    "prbench opens no pickles. Convert each MANO_*.pkl once, in an environment that you trust with it: "
    "`python -c \"import pickle, numpy as np; m = pickle.load(open('MANO_LEFT.pkl', 'rb'), encoding='latin1'); "
    "np.savez('MANO_LEFT.npz', **{k: np.array(m[k].todense() if hasattr(m[k], 'todense') else m[k]) "
    f"for k in '{' '.join(mano.MODEL_KEYS)}'.split()}})\"`"
)
_SHAPES: dict[str, tuple[int, ...]] = {
    "v_template": (mano.N_VERTICES, 3),
    "shapedirs": (mano.N_VERTICES, 3, mano.N_BETAS),
    "posedirs": (mano.N_VERTICES, 3, 135),
    "weights": (mano.N_VERTICES, mano.N_JOINTS),
    "J_regressor": (mano.N_JOINTS, mano.N_VERTICES),
    "kintree_table": (2, mano.N_JOINTS),
    "hands_components": (45, 45),
    "hands_mean": (45,),
}


class _Wrist(msgspec.Struct):
    t_xyz: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]


class _ManoHand(msgspec.Struct):
    wrist_xform: _Wrist
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
    models = read_models(found, folder)
    points = []
    for rows in hands:
        wrist, vertices = mano.pose_hand(models[rows.side], rows.betas, rows.angles, rows.rotation, rows.position)
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
        angles = np.zeros((len(rows), mano.N_COEFFICIENTS))
        for row, (time, hand) in enumerate(rows):
            if len(hand.pose) != mano.N_COEFFICIENTS or len(hand.betas) != mano.N_BETAS:
                found = f"{len(hand.pose)} and {len(hand.betas)}"
                raise InputFileError(path, f"{side} hand at {time} ns", expected="15 and 10 numbers", found=found)
            angles[row] = hand.pose
        betas = np.array(rows[0][1].betas) if rows else np.zeros(mano.N_BETAS)
        hands.append(hand_rows(path, side, [(time, hand.wrist_xform) for time, hand in rows], angles, betas))
    return tuple(hands), remarks


def read_models(found: RecordingFiles, folder: Path | None) -> dict[Literal["left", "right"], mano.ManoModel]:
    """Both hands of the licensed model.

    Raises:
        InputFileError: if one is missing (saying how to convert it) or damaged.
    """
    models: dict[Literal["left", "right"], mano.ManoModel] = {}
    for side in hot3d.HAND_KEYS:
        path, name = found.path(f"{MANO_MODEL_PREFIX}{side}"), f"MANO_{side.upper()}.npz"
        if path is None:
            raise InputFileError(
                (folder or Path("mano")).expanduser() / name,
                "",
                expected="the licensed MANO model as arrays (option mano_models=FOLDER)",
                found="no such file" if folder is not None else "no folder was given",
                remedy=f"{_CONVERT}, and the same for MANO_RIGHT. Without MANO use hands=umetrack.",
            )
        models[side] = _read_model(path)
    models["left"] = mano.without_left_hand_bug(models["left"], models["right"])
    return models


def _read_model(path: Path) -> mano.ManoModel:
    archive = Archive(path, remedy=_CONVERT)
    archive.require(_SHAPES)
    arrays = archive.load(_SHAPES)
    for name, shape in _SHAPES.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind not in "fiu":
            found = f"{arrays[name].shape} of {arrays[name].dtype}"
            raise InputFileError(path, name, expected=f"numbers of the shape {shape}", found=found, remedy=_CONVERT)
    parents = arrays["kintree_table"][0].astype(np.int64)
    parents[0] = -1
    if not (parents[1:] < np.arange(1, mano.N_JOINTS)).all() or (parents[1:] < 0).any():
        raise InputFileError(path, "kintree_table", expected="parents before children", found=str(parents.tolist()))
    wide = {name: array.astype(np.float64) for name, array in arrays.items()}
    return mano.ManoModel(
        template=wide["v_template"],
        shape_directions=wide["shapedirs"],
        pose_directions=wide["posedirs"],
        weights=wide["weights"],
        regressor=wide["J_regressor"],
        parents=parents,
        components=wide["hands_components"][: mano.N_COEFFICIENTS],
        mean_pose=wide["hands_mean"],
    )
