"""Maps of skeletons in common use. Names and orders are facts of those formats; ratios are ours, from anatomy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from prbench.errors import UsageError, did_you_mean
from prbench.geometry.joint_names import XSENS_SEGMENTS, match_names
from prbench.geometry.skeleton import CHAINS, Joint
from prbench.representation.converters.anatomy import NAMES
from prbench.representation.converters.joint_map import JointMap


def joint_map(name: str) -> JointMap:
    """A named map.

    Raises:
        UsageError: if there is none of this name (with the nearest one).
    """
    if name not in JOINT_MAPS:
        raise UsageError(
            f"unknown skeleton '{name}'.{did_you_mean(name, JOINT_MAPS)} Known ones: {', '.join(JOINT_MAPS)}; others"
            " take a map of your own (JointMap.of, JointMap.from_toml)."
        )
    return JOINT_MAPS[name]


def joint_map_by_names(names: Sequence[str], *, name: str = "bvh") -> JointMap:
    """A map for names as BVH files and animation software have them: Mixamo, Rokoko, CMU, LAFAN1.

    Args:
        names: Of the source's joints in order, with any prefix, case and separators.
        name: For messages.

    Raises:
        UsageError: if a limb joint is not found.
    """
    matched = match_names(names)
    return JointMap.of(
        name,
        names,
        {target: names[column] for target, column in zip(NAMES, matched.columns) if column >= 0},
    )


def _paired(**parts: str) -> dict[str, str]:
    """Both sides at once: ``hip="{}Hip"`` with L and R, or ``{side}`` for left and right."""
    return {
        f"{side}_{part}": text.format(side[0].upper(), side=side)
        for part, text in parts.items()
        for side in ("left", "right")
    }


def _smpl(name: str, count: int) -> JointMap:
    """Skeletons whose first 22 joints are ours; what follows (hands, face, surface points) is left away."""
    names = (*NAMES, *(f"joint_{index}" for index in range(len(NAMES), count)))
    return JointMap.of(name, names, {joint: joint for joint in NAMES})


def _chains() -> JointMap:
    """The five kinematic chains of HumanML3D laid end to end, joints that two chains share standing in both."""
    names: list[str] = []
    for joint in (joint for chain in CHAINS for joint in chain):
        plain = Joint(joint).name.lower()
        names.append(plain if plain not in names else f"{plain}_{len(names)}")
    return JointMap.of("humanml3d-chains", names, {joint: joint for joint in NAMES})


_LIMBS = _paired(
    hip="{side}_hip", knee="{side}_knee", ankle="{side}_ankle", shoulder="{side}_shoulder", elbow="{side}_elbow",
    wrist="{side}_wrist",
)  # fmt: skip
_EARS = "0.5 left_ear + 0.5 right_ear - 0.05 @up"
_COCO = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle",
)  # fmt: skip
_BODY_25 = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye",
    "left_eye", "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe",
    "right_small_toe", "right_heel",
)  # fmt: skip
_MEDIAPIPE = (
    "nose", "left_eye_inner", "left_eye", "left_eye_outer", "right_eye_inner", "right_eye", "right_eye_outer",
    "left_ear", "right_ear", "mouth_left", "mouth_right", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_pinky", "right_pinky", "left_index", "right_index",
    "left_thumb", "right_thumb", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "left_heel", "right_heel", "left_foot_index", "right_foot_index",
)  # fmt: skip
_NTU = (
    "spine_base", "spine_mid", "neck", "head", "left_shoulder", "left_elbow", "left_wrist", "left_hand",
    "right_shoulder", "right_elbow", "right_wrist", "right_hand", "left_hip", "left_knee", "left_ankle", "left_foot",
    "right_hip", "right_knee", "right_ankle", "right_foot", "spine_shoulder", "left_hand_tip", "left_thumb",
    "right_hand_tip", "right_thumb",
)  # fmt: skip
_H36M_17 = (
    "hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "spine", "thorax", "neck",
    "head", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder", "right_elbow", "right_wrist",
)  # fmt: skip
_H36M_32 = (
    "Hips", "RightUpLeg", "RightLeg", "RightFoot", "RightToeBase", "RightToeSite", "LeftUpLeg", "LeftLeg",
    "LeftFoot", "LeftToeBase", "LeftToeSite", "Spine", "Spine1", "Neck", "Head", "HeadSite", "LeftShoulder",
    "LeftArm", "LeftForeArm", "LeftHand", "LeftHandThumb", "LeftThumbSite", "L_Wrist_End", "LeftHandSite",
    "RightShoulder", "RightArm", "RightForeArm", "RightHand", "RightHandThumb", "RightThumbSite", "R_Wrist_End",
    "RightHandSite",
)  # fmt: skip
_MIXAMO = (
    "Hips", "Spine", "Spine1", "Spine2", "Neck", "Head", "LeftShoulder", "LeftArm", "LeftForeArm", "LeftHand",
    "RightShoulder", "RightArm", "RightForeArm", "RightHand", "LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase",
    "RightUpLeg", "RightLeg", "RightFoot", "RightToeBase",
)  # fmt: skip

_ANIMATION_LIMBS = {
    f"{side}_{part}": f"{side.capitalize()}{name}"
    for side in ("left", "right")
    for part, name in (
        ("hip", "UpLeg"), ("knee", "Leg"), ("ankle", "Foot"), ("foot", "ToeBase"), ("shoulder", "Arm"),
        ("elbow", "ForeArm"), ("wrist", "Hand"),
    )
}  # fmt: skip


_ALL = (
    _smpl("humanml3d-22", 22),
    _chains(),
    _smpl("smpl-24", 24),
    _smpl("smpl-45", 45),
    _smpl("smplh-52", 52),
    _smpl("smplh-73", 73),
    _smpl("smplx-55", 55),
    _smpl("smplx-127", 127),
    _smpl("smplx-144", 144),
    JointMap.of("coco-17", _COCO, {**_LIMBS, "head": _EARS}),
    JointMap.of(
        "openpose-25",
        _BODY_25,
        {
            **_LIMBS,
            **_paired(foot="0.35 {side}_ankle + 0.4 {side}_big_toe + 0.25 {side}_small_toe"),
            "head": _EARS,
        },
    ),
    JointMap.of(
        "mediapipe-33",
        _MEDIAPIPE,
        {**_LIMBS, **_paired(foot="0.35 {side}_ankle + 0.65 {side}_foot_index"), "head": _EARS},
    ),
    JointMap.of(
        "ntu-25",
        _NTU,
        {**_LIMBS, **_paired(foot="{side}_foot"), "neck": "neck", "head": "0.65 neck + 0.35 head + 0.08 @forward"},
    ),
    JointMap.of(
        "h36m-17",
        _H36M_17,
        {**_LIMBS, "neck": "0.35 thorax + 0.65 neck", "head": "0.9 neck + 0.1 head + 0.08 @forward"},
    ),
    JointMap.of(
        "h36m-32",
        _H36M_32,
        {**_ANIMATION_LIMBS, "neck": "0.35 Neck + 0.65 Head", "head": "0.9 Head + 0.1 HeadSite + 0.08 @forward"},
    ),
    JointMap.of(
        "xsens-23",
        XSENS_SEGMENTS,
        {
            **_paired(
                hip="{}_UpperLeg", knee="{}_LowerLeg", ankle="{}_Foot", foot="{}_Toe", collar="{}_Shoulder",
                shoulder="{}_UpperArm", elbow="{}_Forearm", wrist="{}_Hand",
            ),
            "pelvis": "L5", "spine1": "L3", "spine2": "T12", "spine3": "T8", "neck": "Neck", "head": "Head",
        },
    ),
    JointMap.of(
        "mixamo",
        _MIXAMO,
        {
            **_ANIMATION_LIMBS, "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2",
            "neck": "Neck", "head": "Head", "left_collar": "LeftShoulder", "right_collar": "RightShoulder",
        },
    ),
)  # fmt: skip

JOINT_MAPS: Mapping[str, JointMap] = MappingProxyType({one.name: one for one in _ALL})
"""All named maps."""
