"""What other skeletons would say of a known motion: joint centres as they are, landmarks where anatomy has them.

Landmarks are rigid in the head's or the foot's frame, at distances in metres that an adult has (ears beside the skull's
base, toes a foot's length ahead); they were chosen before and apart from the maps that are tested with them.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import CHAINS, Joint
from prbench.representation.converters import JOINT_MAPS
from prbench.synthetic.people.perform import perform

_HEAD = {  # left, up, forward of the head joint
    "nose": (0.0, 0.035, 0.13),
    "left_eye": (0.032, 0.06, 0.105),
    "left_ear": (0.075, 0.035, 0.015),
    "head_centre": (0.0, 0.07, 0.045),
    "head_top": (0.0, 0.17, 0.03),
    "skull_base": (0.0, 0.005, -0.03),
}
_FOOT = {  # left, up, forward of the ankle, in the frame of the flat foot (left foot)
    "left_big_toe": (-0.02, -0.075, 0.20),
    "left_small_toe": (0.05, -0.075, 0.15),
    "left_heel": (0.0, -0.07, -0.055),
    "left_foot_index": (0.0, -0.075, 0.205),
}


@cache
def known_motion() -> tuple[np.ndarray, np.ndarray]:
    """Joints (n, 22, 3) and head rotations (n, 3, 3) of a procedural person with a bent and turning head."""
    performance = perform("hd-epic", seed=11, index=3, n_events=2, provocations={})
    part = slice(300, 1500, 5)
    return performance.joints[part], Rotation.from_quat(performance.head_rotation[part], scalar_first=True).as_matrix()


@cache
def landmarks() -> dict[str, np.ndarray]:
    """Every joint and landmark of the motion by name, (n, 3) each."""
    joints, head_rotation = known_motion()
    places = {joint.name.lower(): joints[:, joint] for joint in Joint}
    for name, offset in _HEAD.items():
        for side, sign in (("left", 1), ("right", -1)):
            turned = head_rotation @ (np.array(offset) * (sign, 1, 1))
            places[name.replace("left", side)] = joints[:, Joint.HEAD] + turned
    for side, sign in (("left", 1), ("right", -1)):
        ankle, ball = places[f"{side}_ankle"], places[f"{side}_foot"]
        forward = _unit(ball - ankle - _part_along_y(ball - ankle))
        forward = _tilted(forward, ball - ankle)
        left = _unit(np.cross(np.array([0.0, 1.0, 0.0]), forward))
        up = np.cross(forward, left)
        for name, (x, y, z) in _FOOT.items():
            offset = sign * x * left + y * up + z * forward
            places[name.replace("left", side)] = ankle + offset
    shoulders = (places["left_shoulder"] + places["right_shoulder"]) / 2
    places["mid_shoulders"] = shoulders + 0.02 * _unit(places["neck"] - places["pelvis"])
    places["mid_hip"] = (places["left_hip"] + places["right_hip"]) / 2
    return places


def seen_as(skeleton: str) -> np.ndarray:
    """The known motion (n, joints, 3) as the named skeleton has it; joints that no map asks for are zero."""
    places = landmarks()
    names = JOINT_MAPS[skeleton].source_joints
    seen = np.zeros((len(places["pelvis"]), len(names), 3))
    chains = [Joint(joint).name.lower() for chain in CHAINS for joint in chain]
    for column, name in enumerate(names):
        place = chains[column] if skeleton == "humanml3d-chains" else ALIASES.get(skeleton, {}).get(name, name)
        if place in places:
            seen[:, column] = places[place]
    return seen


def _sides(**names: str) -> dict[str, str]:
    """Source name with {} for the side (``Left``, ``L`` …) to the landmark without its side."""
    return {
        pattern.format(S=side.capitalize(), s=side, L=side[0].upper()): f"{side}_{place}"
        for place, pattern in names.items()
        for side in ("left", "right")
    }


_ANIMATION = _sides(
    hip="{S}UpLeg", knee="{S}Leg", ankle="{S}Foot", foot="{S}ToeBase", shoulder="{S}Arm", elbow="{S}ForeArm",
    wrist="{S}Hand",
)  # fmt: skip
ALIASES: dict[str, dict[str, str]] = {
    "openpose-25": {"neck": "mid_shoulders"},
    "mediapipe-33": {},
    "ntu-25": {"spine_base": "mid_hip", "spine_shoulder": "mid_shoulders", "head": "head_centre"},
    "h36m-17": {"hip": "mid_hip", "thorax": "mid_shoulders", "neck": "skull_base", "head": "head_top"},
    "h36m-32": {
        **_ANIMATION, "Hips": "mid_hip", "Neck": "mid_shoulders", "Head": "skull_base", "HeadSite": "head_top",
    },
    "xsens-23": {
        **_sides(
            hip="{L}_UpperLeg", knee="{L}_LowerLeg", ankle="{L}_Foot", foot="{L}_Toe", collar="{L}_Shoulder",
            shoulder="{L}_UpperArm", elbow="{L}_Forearm", wrist="{L}_Hand",
        ),
        "L5": "pelvis", "L3": "spine1", "T12": "spine2", "T8": "spine3", "Neck": "neck", "Head": "head",
    },
    "mixamo": {
        **_ANIMATION, **_sides(collar="{S}Shoulder"), "Hips": "pelvis", "Spine": "spine1", "Spine1": "spine2",
        "Spine2": "spine3", "Neck": "neck", "Head": "head",
    },
}  # fmt: skip


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _part_along_y(vectors: np.ndarray) -> np.ndarray:
    return vectors * np.array([0.0, 1.0, 0.0])


def _tilted(forward: np.ndarray, bone: np.ndarray) -> np.ndarray:
    """Forward of the sole: the ankle-ball bone of a flat foot falls by 25 degrees, whatever more is the foot's tilt."""
    fall = np.arctan2(-bone[:, 1], (bone * forward).sum(axis=-1)) - np.deg2rad(25.3)
    down = np.array([0.0, -1.0, 0.0])
    return np.cos(fall)[:, None] * forward + np.sin(fall)[:, None] * down
