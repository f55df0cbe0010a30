"""Inverse kinematics: joints and segment rotations of a performance as a joint state of MoGaze's human model.

The model has fewer joints than the performance's spine, and every link hangs on its parent along fixed axes. So each
link's frame is the segment's, tipped until the child lies where the model wants it. Everything is exact but the
distance from pelvis to torso, which is fixed: where the back bends, the upper body is up to a centimetre further along
the trunk (docs/specification/synthetic-recordings.md#native-layouts).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from prbench.geometry.axes import Y_UP_FROM_Z_UP
from prbench.geometry.skeleton import Joint
from prbench.readers.mogaze.body import LINKS, MODEL_OFFSETS, OFFSET_KEYS, PARENT_LINKS

_TO_WORLD = Y_UP_FROM_Z_UP[:3, :3]
_SEGMENT_AXES = _TO_WORLD
"""Columns: the link's axes (left, back, up) in the frame of a trunk segment (left, up, forward)."""
_ARM_AXES = {"l": np.array([(0, 1, 0), (0, 0, 1), (1, 0, 0)]).T, "r": np.array([(0, -1, 0), (0, 0, 1), (-1, 0, 0)]).T}
"""The same of arms, whose segments have y along the bone and x along the hinge; arms are spread at zero angles."""
_LEG_AXES = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)]).T
"""The same of legs, which hang at zero angles."""

_JOINT_OF_LINK: dict[str, Joint] = {
    "pelvis": Joint.PELVIS, "torso": Joint.SPINE3, "neck": Joint.NECK, "head": Joint.HEAD,
    "linnerShoulder": Joint.LEFT_COLLAR, "lShoulder": Joint.LEFT_SHOULDER, "lElbow": Joint.LEFT_ELBOW,
    "lWrist": Joint.LEFT_WRIST, "rinnerShoulder": Joint.RIGHT_COLLAR, "rShoulder": Joint.RIGHT_SHOULDER,
    "rElbow": Joint.RIGHT_ELBOW, "rWrist": Joint.RIGHT_WRIST, "lHip": Joint.LEFT_HIP, "lKnee": Joint.LEFT_KNEE,
    "lAnkle": Joint.LEFT_ANKLE, "lToe": Joint.LEFT_FOOT, "rHip": Joint.RIGHT_HIP, "rKnee": Joint.RIGHT_KNEE,
    "rAnkle": Joint.RIGHT_ANKLE, "rToe": Joint.RIGHT_FOOT,
}  # fmt: skip


@dataclass(frozen=True)
class SolvedBody:
    """A joint state without noise."""

    state: Float[np.ndarray, "n 66"]
    """Columns as in :data:`prbench.readers.mogaze.body.STATE_COLUMNS`."""
    fixed: dict[str, float]
    """The 60 scaling values, metres."""


def solve_body(joints: Float[np.ndarray, "n 22 3"], rotations: Float[np.ndarray, "n 22 4"]) -> SolvedBody:
    """Solve the joint state and the fixed offsets of a performance.

    Args:
        joints: World frame, Y up, metres.
        rotations: See :attr:`prbench.synthetic.performance.Performance.rotations`.
    """
    hips = (joints[:, Joint.LEFT_HIP] + joints[:, Joint.RIGHT_HIP]) / 2
    places = {"base": hips} | {link: joints[:, joint] for link, joint in _JOINT_OF_LINK.items()}
    turned = _link_rotations(places, rotations)
    fixed = _fixed_offsets(places, turned)
    angles = [turned["base"].as_euler("XYZ")]
    angles += [(turned[PARENT_LINKS[link]].inv() * turned[link]).as_euler("XYZ") for link in LINKS[1:]]
    to_native = Rotation.from_matrix(_TO_WORLD.T)
    angles[0] = (to_native * turned["base"]).as_euler("XYZ")
    return SolvedBody(np.hstack([to_native.apply(hips), *angles]), fixed)


def _link_rotations(places: dict[str, np.ndarray], rotations: np.ndarray) -> dict[str, Rotation]:
    """Return the rotations that take each link to the world (Y up)."""
    segment = {joint: Rotation.from_quat(rotations[:, joint], scalar_first=True) for joint in Joint}
    trunk = Rotation.from_matrix(_SEGMENT_AXES)
    leg = Rotation.from_matrix(_LEG_AXES)
    pelvis = segment[Joint.PELVIS] * trunk
    chest = segment[Joint.SPINE3] * trunk
    turned = {
        "base": _tipped(pelvis, "Z", places["pelvis"] - places["base"]),
        "pelvis": _tipped(pelvis, "Z", places["torso"] - places["pelvis"]),
        "torso": _tipped(chest, "Z", places["neck"] - places["torso"]),
        "neck": segment[Joint.NECK] * trunk,
        "head": segment[Joint.HEAD] * trunk,
    }
    for side, letter in enumerate("lr"):
        arm = Rotation.from_matrix(_ARM_AXES[letter])
        inner, outer = (places[f"{letter}{name}"] for name in ("innerShoulder", "Shoulder"))
        outwards = outer - inner if letter == "l" else inner - outer
        turned[f"{letter}innerShoulder"] = _tipped(chest, "X", outwards)
        for name, joint in (
            ("Shoulder", Joint.LEFT_SHOULDER),
            ("Elbow", Joint.LEFT_ELBOW),
            ("Wrist", Joint.LEFT_WRIST),
        ):
            turned[f"{letter}{name}"] = segment[Joint(joint + side)] * arm
        for name, joint in (("Hip", Joint.LEFT_HIP), ("Knee", Joint.LEFT_KNEE)):
            turned[f"{letter}{name}"] = segment[Joint(joint + side)] * leg
        for name, joint in (("Ankle", Joint.LEFT_ANKLE), ("Toe", Joint.LEFT_FOOT)):
            turned[f"{letter}{name}"] = segment[Joint(joint + side)] * trunk
    return turned


def _tipped(frames: Rotation, axis: str, towards: Float[np.ndarray, "n 3"]) -> Rotation:
    """Turn frames by the smallest angle that brings one of their axes onto a direction."""
    present = frames.as_matrix()[:, :, "XYZ".index(axis)]
    wanted = towards / np.linalg.norm(towards, axis=1, keepdims=True)
    about = np.cross(present, wanted)
    sine = np.linalg.norm(about, axis=1, keepdims=True)
    cosine = np.einsum("ni,ni->n", present, wanted)[:, None]
    angle = np.arctan2(sine, cosine)
    return Rotation.from_rotvec(about * np.divide(angle, sine, out=np.ones_like(sine), where=sine > 1e-12)) * frames


def _fixed_offsets(places: dict[str, np.ndarray], turned: dict[str, Rotation]) -> dict[str, float]:
    """Return the 60 values; those without a joint in the model are nothing but zeros."""
    fixed = dict.fromkeys(OFFSET_KEYS, 0.0)
    for link in LINKS[1:]:
        parent = PARENT_LINKS[link]
        local = turned[parent].inv().apply(places[link] - places[parent])
        middle = local[int(np.argmax(local[:, 2]))] if link == "torso" else np.median(local, axis=0)
        for axis, letter in enumerate("XYZ"):
            key = f"{link}Trans{letter}"
            if key in MODEL_OFFSETS:
                fixed[key] = float(middle[axis])
    return fixed
