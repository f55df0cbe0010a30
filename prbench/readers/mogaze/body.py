"""MoGaze's human model: its chain, forward kinematics, and the 22 joints.

Sources: docs/specification/mogaze.md#files, docs/specification/mogaze.md#world-and-body-frames,
docs/specification/mogaze.md#forward-kinematics and docs/specification/mogaze.md#the-22-joints.

The model is the humoro player's ``human.urdf`` (MIT licence): every joint origin is the identity, so a link is
``T_child = T_parent * translate(offset) * Rx * Ry * Rz``. Body axes at zero angles: +X left, -Y forward, +Z up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

PARENT_LINKS: dict[str, str] = {
    "base": "",
    "pelvis": "base",
    "torso": "pelvis",
    "neck": "torso",
    "head": "neck",
    "linnerShoulder": "torso",
    "lShoulder": "linnerShoulder",
    "lElbow": "lShoulder",
    "lWrist": "lElbow",
    "rinnerShoulder": "torso",
    "rShoulder": "rinnerShoulder",
    "rElbow": "rShoulder",
    "rWrist": "rElbow",
    "lHip": "base",
    "lKnee": "lHip",
    "lAnkle": "lKnee",
    "lToe": "lAnkle",
    "rHip": "base",
    "rKnee": "rHip",
    "rAnkle": "rKnee",
    "rToe": "rAnkle",
}
"""The 21 joints in the order of the files, each with the joint that it hangs on; parents come first."""
LINKS: tuple[str, ...] = tuple(PARENT_LINKS)
_N_LINKS = len(LINKS)

STATE_COLUMNS: tuple[str, ...] = (
    *(f"baseTrans{axis}" for axis in "XYZ"),
    *(f"{link}Rot{axis}" for link in LINKS for axis in "XYZ"),
)
"""The 66 columns of a joint state in their usual order; files are read by name. Metres and radians."""
OFFSET_KEYS: tuple[str, ...] = tuple(f"{link}Trans{axis}" for link in LINKS[1:] for axis in "XYZ")
"""The 60 fixed scaling values of a recording, metres."""

_TRANSLATION_AXES: dict[str, str] = {
    "pelvis": "Z", "torso": "XYZ", "neck": "Z", "head": "YZ", "innerShoulder": "XYZ", "Shoulder": "X", "Elbow": "X",
    "Wrist": "XYZ", "Hip": "X", "Knee": "Z", "Ankle": "XYZ", "Toe": "YZ",
}  # fmt: skip


def _axes_of(link: str) -> str:
    return _TRANSLATION_AXES[link if link in _TRANSLATION_AXES else link[1:]]


MODEL_OFFSETS: frozenset[str] = frozenset(f"{link}Trans{axis}" for link in LINKS[1:] for axis in _axes_of(link))
"""The fixed values for which the model has a joint; the player ignores the others (below 2e-8 m in p1_1)."""

HEAD_FORWARD = (0.0, -1.0, 0.0)
"""In the frame of the head link."""
HEAD_FROM_CPF = ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0))
"""Columns: left, up and forward of the face in the frame of the head link."""


def link_offsets(fixed: Mapping[str, float]) -> Float[np.ndarray, "21 3"]:
    """Constant offset of each link in its parent's frame, metres; zero for the base.

    Limits of the model are not applied: the data hold negative offsets where it allows [0, 1].

    Args:
        fixed: ``keys_fixed`` and ``values_fixed``; keys without a joint of the model are ignored.

    Raises:
        KeyError: naming a value that the model needs and ``fixed`` lacks.
    """
    offsets = np.zeros((_N_LINKS, 3))
    for index, link in enumerate(LINKS[1:], start=1):
        for axis, letter in enumerate("XYZ"):
            key = f"{link}Trans{letter}"
            if key in MODEL_OFFSETS:
                offsets[index, axis] = fixed[key]
    return offsets


def forward_kinematics(
    state: Float[np.ndarray, "n 66"], offsets: Float[np.ndarray, "21 3"]
) -> tuple[Float[np.ndarray, "n 21 3"], Float[np.ndarray, "n 21 3 3"]]:
    """Positions (metres) and rotations of the 21 links in the dataset's world (Z up).

    Args:
        state: Columns as in :data:`STATE_COLUMNS`; rows with NaN give NaN.
        offsets: See :func:`link_offsets`.
    """
    local = intrinsic_xyz(state[:, 3:].reshape(-1, _N_LINKS, 3))
    positions = np.empty((len(state), _N_LINKS, 3))
    rotations = np.empty((len(state), _N_LINKS, 3, 3))
    positions[:, 0] = state[:, :3]
    rotations[:, 0] = local[:, 0]
    for index, link in enumerate(LINKS[1:], start=1):
        parent = LINKS.index(PARENT_LINKS[link])
        positions[:, index] = positions[:, parent] + rotations[:, parent] @ offsets[index]
        rotations[:, index] = rotations[:, parent] @ local[:, index]
    return positions, rotations


def intrinsic_xyz(angles: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices Rx(a) Ry(b) Rz(c), radians."""
    (cos_x, cos_y, cos_z), (sin_x, sin_y, sin_z) = (np.moveaxis(f(angles), -1, 0) for f in (np.cos, np.sin))
    matrix = np.empty((*angles.shape, 3))
    matrix[..., 0, 0] = cos_y * cos_z
    matrix[..., 0, 1] = -cos_y * sin_z
    matrix[..., 0, 2] = sin_y
    matrix[..., 1, 0] = sin_x * sin_y * cos_z + cos_x * sin_z
    matrix[..., 1, 1] = cos_x * cos_z - sin_x * sin_y * sin_z
    matrix[..., 1, 2] = -sin_x * cos_y
    matrix[..., 2, 0] = sin_x * sin_z - cos_x * sin_y * cos_z
    matrix[..., 2, 1] = cos_x * sin_y * sin_z + sin_x * cos_z
    matrix[..., 2, 2] = cos_x * cos_y
    return matrix


def body_joints(positions: Float[np.ndarray, "n 21 3"], mapping: Sequence[str]) -> Float[np.ndarray, "n 22 3"]:
    """The 22 joints from the 21 links.

    Args:
        positions: Of the links, metres.
        mapping: For each of the 22 joints a link (``torso``), the mean of some (``pelvis+torso``), or a weighted sum
            (``0.63 pelvis + 0.37 torso``).
    """
    weights = np.stack([_weights(entry) for entry in mapping])
    return np.einsum("jl,nlk->njk", weights, positions)


def _weights(entry: str) -> Float[np.ndarray, "21"]:
    terms = [term.split() for term in entry.split("+")]
    weights = np.zeros(_N_LINKS)
    for term in terms:
        weights[LINKS.index(term[-1])] += float(term[0]) if len(term) == 2 else 1 / len(terms)
    return weights
