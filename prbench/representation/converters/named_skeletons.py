"""Checked maps from any skeleton to the 22 joints, and those of skeletons that are known by name.

Missing joints follow from the proportions of the 22-joint skeleton. The ratios are means of two bodies: the mean pose
of HumanML3D (the public ``Mean.npy``), and the proportions of the synthetic people. Unit is the trunk, from the middle
of the hips to the middle of the shoulders, about 0.53 m in an adult. What each costs is measured in
``docs/wrapping.md``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import Float, Num

from prbench.errors import UsageError, did_you_mean
from prbench.files.bounded import require
from prbench.geometry.skeleton import CHAINS, N_JOINTS, XSENS_SEGMENTS, Joint, match_names

# Directions of the trunk, each as long as the trunk (middle of the hips to middle of the shoulders): ``@up`` along it,
# ``@forward`` and ``@left`` across; ``@ahead`` is forward on the ground plane, ``@above`` the vertical.
_AXES = ("@up", "@forward", "@left", "@ahead", "@above")

_TERM = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)?\s*(?P<name>[@A-Za-z_].*)")
_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Expression:
    """A sum of joints whose weights add up to 1, plus offsets along the axes of the trunk."""

    joints: tuple[tuple[str, float], ...]
    axes: tuple[tuple[str, float], ...] = ()


def parse_expression(text: str, known: Iterable[str], *, where: str) -> Expression:
    """``wrist``, ``a + b`` (the mean of two), ``0.6 a + 0.4 b``, ``neck + 0.2 @up - 0.1 @forward``.

    Args:
        text: The expression; spaces around signs.
        known: Names of the source's joints.
        where: What the message begins with.

    Raises:
        UsageError: if a name is unknown (with the nearest one), weights are given to some joints only, or do not add
            up to 1.
    """
    names = list(known)
    joints: list[tuple[str, float | None]] = []
    axes: list[tuple[str, float]] = []
    parts = re.split(r"\s+([+-])\s+", text.strip())
    for sign, term in [("+", parts[0]), *zip(parts[1::2], parts[2::2])]:
        matched = _TERM.fullmatch(term)
        if matched is None:
            raise UsageError(f"{where}: expected joints and numbers such as '0.6 neck + 0.4 head', found '{text}'.")
        name = matched["name"].strip()
        number = matched["number"]
        weight = None
        if number is not None or sign == "-":
            weight = float(number or 1) * (1.0 if sign == "+" else -1.0)
        if name in names:
            joints.append((name, weight))
        elif name in _AXES:
            axes.append((name, 1.0 if weight is None else weight))
        else:
            why = f"unknown joint '{name}'.{did_you_mean(name, [*names, *_AXES])} The source has: {', '.join(names)}."
            raise UsageError(f"{where}: {why}")
    given = [weight for _, weight in joints if weight is not None]
    if joints and not given:
        return Expression(tuple((name, 1 / len(joints)) for name, _ in joints), tuple(axes))
    if not joints or len(given) != len(joints) or abs(sum(given) - 1) > _SUM_TOLERANCE:
        found = f"found '{text}' ({sum(given):g} in all)."
        raise UsageError(f"{where}: expected weights of all joints, which add up to 1, or of none, {found}")
    return Expression(tuple((name, weight) for (name, _), weight in zip(joints, given)), tuple(axes))


# The 22 joints as maps write them.
NAMES: tuple[str, ...] = tuple(joint.name.lower() for joint in Joint)

# Joints that every source must have: without them nothing can be completed.
LIMBS: tuple[Joint, ...] = tuple(
    Joint[f"{side}_{part}"]
    for part in ("HIP", "KNEE", "ANKLE", "SHOULDER", "ELBOW", "WRIST")
    for side in ("LEFT", "RIGHT")
)

_HIPS = "0.5 left_hip + 0.5 right_hip"
_SHOULDERS = "0.5 left_shoulder + 0.5 right_shoulder"
_RULES: Mapping[str, str] = MappingProxyType(
    {
        "pelvis": f"{_HIPS} + 0.19 @up + 0.015 @forward",
        "spine1": f"{_HIPS} + 0.385 @up - 0.03 @forward",
        "spine2": f"{_HIPS} + 0.657 @up + 0.01 @forward",
        "spine3": f"{_HIPS} + 0.767 @up + 0.03 @forward",
        "neck": f"{_SHOULDERS} + 0.172 @up + 0.016 @forward",
        "left_collar": "0.685 left_shoulder + 0.315 right_shoulder - 0.01 @up + 0.01 @forward",
        "right_collar": "0.315 left_shoulder + 0.685 right_shoulder - 0.01 @up + 0.01 @forward",
        "head": "neck + 0.104 @up + 0.119 @forward",
        "left_foot": "left_ankle + 0.244 @ahead - 0.112 @above",
        "right_foot": "right_ankle + 0.244 @ahead - 0.112 @above",
    }
)

# Maps each joint that may be missing to the rule that makes it; each rule needs only joints of earlier ones.
COMPLETIONS: Mapping[Joint, Expression] = MappingProxyType(
    {Joint[name.upper()]: parse_expression(rule, NAMES, where=name) for name, rule in _RULES.items()}
)


def trunk_axes(joints: Float[np.ndarray, "*batch 22 3"]) -> dict[str, Float[np.ndarray, "*batch 3"]]:
    """Return the axes of expressions, each as long as the trunk; hips and shoulders must be there.

    Args:
        joints: Y up, metres; joints that are still missing may be NaN.
    """
    hips = (joints[..., Joint.LEFT_HIP, :] + joints[..., Joint.RIGHT_HIP, :]) / 2
    trunk = (joints[..., Joint.LEFT_SHOULDER, :] + joints[..., Joint.RIGHT_SHOULDER, :]) / 2 - hips
    length = np.linalg.norm(trunk, axis=-1, keepdims=True)
    up = _unit(trunk)
    across = joints[..., Joint.LEFT_HIP, :] - joints[..., Joint.RIGHT_HIP, :]
    across = _unit(across) + _unit(joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :])
    left = _unit(across - (across * up).sum(axis=-1, keepdims=True) * up)
    ahead = np.stack([-left[..., 2], np.zeros(left.shape[:-1]), left[..., 0]], axis=-1)
    above = np.broadcast_to(np.array([0.0, 1.0, 0.0]), up.shape)
    directions = (up, np.cross(left, up), left, _unit(ahead), above)
    return {name: direction * length for name, direction in zip(_AXES, directions)}


def placed(
    expression: Expression,
    columns: Mapping[str, int],
    joints: Float[np.ndarray, "frames joints 3"],
    axes: Mapping[str, Float[np.ndarray, "frames 3"]],
) -> Float[np.ndarray, "frames 3"]:
    """Evaluate an expression, frame by frame."""
    place = sum(weight * joints[:, columns[name]] for name, weight in expression.joints)
    return np.asarray(place + sum(weight * axes[name] for name, weight in expression.axes))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


_TRUNK = (Joint.LEFT_HIP, Joint.RIGHT_HIP, Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)


@dataclass(frozen=True)
class JointMap:
    """The 22 joints in terms of another skeleton's. Make one with :meth:`of`, which checks it.

    Attributes:
        source_joints: Names of the source, in the order of its arrays.
        expressions: Expressions of the joints that the source has.
    """

    name: str
    source_joints: tuple[str, ...]
    expressions: Mapping[Joint, Expression]

    @classmethod
    def of(cls, name: str, source_joints: Sequence[str], given: Mapping[str, str]) -> JointMap:
        """Return a checked map.

        Args:
            name: Name that messages begin with.
            source_joints: Names of the source's joints, in the order of its arrays, each once.
            given: Source expression of each of the 22 (``{"pelvis": "hips", "neck": "0.7 thorax + 0.3 head"}``). The
                twelve limb joints must be there; of the others, the missing ones are completed (:attr:`completed`).

        Raises:
            UsageError: if a name is unknown (with the nearest one), a limb joint is missing, or weights do not add up.
        """
        names = tuple(source_joints)
        repeated = sorted({joint for joint in names if names.count(joint) > 1})
        if repeated:
            raise UsageError(f"joint map '{name}': source joints named more than once: {', '.join(repeated)}.")
        unknown = [target for target in given if target not in NAMES]
        if unknown:
            near = did_you_mean(unknown[0], NAMES)
            raise UsageError(
                f"joint map '{name}': '{unknown[0]}' is none of the 22 joints.{near} They are: {', '.join(NAMES)}."
            )
        missing = [joint.name.lower() for joint in LIMBS if joint.name.lower() not in given]
        if missing:
            raise UsageError(f"joint map '{name}': expected the twelve limb joints, missing: {', '.join(missing)}.")
        expressions = {
            Joint[target.upper()]: parse_expression(text, names, where=f"joint map '{name}', {target}")
            for target, text in given.items()
        }
        for joint in _TRUNK:
            if expressions[joint].axes:
                why = "hips and shoulders give the trunk its axes and cannot themselves be offset along them."
                raise UsageError(f"joint map '{name}', {joint.name.lower()}: {why}")
        return cls(name, names, expressions)

    @property
    def completed(self) -> tuple[Joint, ...]:
        """Joints that the source lacks, and that are made from the others with fixed proportions."""
        return tuple(joint for joint in COMPLETIONS if joint not in self.expressions)

    def to_22(
        self, joints: Num[np.ndarray, "frames ..."], *, source: Path | str = "joints"
    ) -> Float[np.ndarray, "frames 22 3"]:
        """Return the 22 joints.

        Args:
            joints: (frames, joints of the source, 3): Y up, right-handed
                (:func:`prbench.representation.converters.to_y_up`), any unit.
            source: Name that messages begin with.

        Returns:
            Same world and unit; floating point.

        Raises:
            InputFileError: if the array has another number of joints.
        """
        fits = joints.ndim == 3 and joints.shape[1:] == (len(self.source_joints), 3)
        expected = f"(frames, {len(self.source_joints)}, 3) for the skeleton '{self.name}'"
        remedy = "Name the skeleton that the joints are of (JOINT_MAPS), or write its map."
        require(source, (fits, "", expected, joints.shape, remedy))
        native = joints.astype(np.float64)
        columns = {name: index for index, name in enumerate(self.source_joints)}
        body = np.full((len(joints), N_JOINTS, 3), np.nan)
        for joint in _TRUNK:
            body[:, joint] = placed(self.expressions[joint], columns, native, {})
        axes = trunk_axes(body)
        for joint, expression in self.expressions.items():
            body[:, joint] = placed(expression, columns, native, axes)
        own = dict(zip(NAMES, range(N_JOINTS)))
        for joint in self.completed:
            body[:, joint] = placed(COMPLETIONS[joint], own, body, axes)
        return body.astype(np.result_type(joints.dtype, np.float32))


def joint_map(name: str) -> JointMap:
    """Return a named map.

    Raises:
        UsageError: if there is none of this name (with the nearest one).
    """
    if name not in JOINT_MAPS:
        raise UsageError(
            f"unknown skeleton '{name}'.{did_you_mean(name, JOINT_MAPS)} Known ones: {', '.join(JOINT_MAPS)}; others"
            " take a map of your own (JointMap.of)."
        )
    return JOINT_MAPS[name]


def joint_map_by_names(names: Sequence[str], *, name: str = "bvh") -> JointMap:
    """Return a map for names as BVH files and animation software have them: Mixamo, Rokoko, CMU, LAFAN1.

    Args:
        names: Names of the source's joints in order, with any prefix, case and separators.
        name: Name that messages begin with.

    Raises:
        UsageError: if a limb joint is not found.
    """
    columns, _, _ = match_names(names)
    return JointMap.of(name, names, {target: names[column] for target, column in zip(NAMES, columns) if column >= 0})


def _paired(**parts: str) -> dict[str, str]:
    """Both sides at once: ``hip="{}Hip"`` with L and R, or ``{side}`` for left and right."""
    return {
        f"{side}_{part}": text.format(side[0].upper(), side=side)
        for part, text in parts.items()
        for side in ("left", "right")
    }


_LIMBS = _paired(
    hip="{side}_hip", knee="{side}_knee", ankle="{side}_ankle", shoulder="{side}_shoulder", elbow="{side}_elbow",
    wrist="{side}_wrist",
)  # fmt: skip
_EARS = {"head": "0.5 left_ear + 0.5 right_ear - 0.05 @up"}
_ANIMATION_LIMBS = {
    f"{side}_{part}": f"{side.capitalize()}{name}"
    for side in ("left", "right")
    for part, name in (
        ("hip", "UpLeg"), ("knee", "Leg"), ("ankle", "Foot"), ("foot", "ToeBase"), ("shoulder", "Arm"),
        ("elbow", "ForeArm"), ("wrist", "Hand"),
    )
}  # fmt: skip
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

_OURS = {joint: joint for joint in NAMES}
# The five kinematic chains of HumanML3D laid end to end, joints that two chains share standing in both.
_CHAIN_JOINTS = [NAMES[joint] for chain in CHAINS for joint in chain]
_CHAINS = [name if name not in _CHAIN_JOINTS[:place] else f"{name}_{place}" for place, name in enumerate(_CHAIN_JOINTS)]


def _smpl(count: int) -> tuple[Sequence[str], Mapping[str, str]]:
    """Skeletons whose first 22 joints are ours; what follows (hands, face, surface points) is left away."""
    return (*NAMES, *(f"joint_{index}" for index in range(N_JOINTS, count))), _OURS


_SKELETONS: Mapping[str, tuple[Sequence[str], Mapping[str, str]]] = {
    "humanml3d-22": _smpl(22),
    "humanml3d-chains": (_CHAINS, _OURS),
    "smpl-24": _smpl(24),
    "smpl-45": _smpl(45),
    "smplh-52": _smpl(52),
    "smplh-73": _smpl(73),
    "smplx-55": _smpl(55),
    "smplx-127": _smpl(127),
    "smplx-144": _smpl(144),
    "coco-17": (_COCO, {**_LIMBS, **_EARS}),
    "openpose-25": (
        _BODY_25,
        {**_LIMBS, **_paired(foot="0.35 {side}_ankle + 0.4 {side}_big_toe + 0.25 {side}_small_toe"), **_EARS},
    ),
    "mediapipe-33": (
        _MEDIAPIPE,
        {**_LIMBS, **_paired(foot="0.35 {side}_ankle + 0.65 {side}_foot_index"), **_EARS},
    ),
    "ntu-25": (
        _NTU,
        {**_LIMBS, **_paired(foot="{side}_foot"), "neck": "neck", "head": "0.65 neck + 0.35 head + 0.08 @forward"},
    ),
    "h36m-17": (
        _H36M_17,
        {**_LIMBS, "neck": "0.35 thorax + 0.65 neck", "head": "0.9 neck + 0.1 head + 0.08 @forward"},
    ),
    "h36m-32": (
        _H36M_32,
        {**_ANIMATION_LIMBS, "neck": "0.35 Neck + 0.65 Head", "head": "0.9 Head + 0.1 HeadSite + 0.08 @forward"},
    ),
    "xsens-23": (
        XSENS_SEGMENTS,
        {
            **_paired(
                hip="{}_UpperLeg", knee="{}_LowerLeg", ankle="{}_Foot", foot="{}_Toe", collar="{}_Shoulder",
                shoulder="{}_UpperArm", elbow="{}_Forearm", wrist="{}_Hand",
            ),
            "pelvis": "L5", "spine1": "L3", "spine2": "T12", "spine3": "T8", "neck": "Neck", "head": "Head",
        },
    ),
    "mixamo": (
        _MIXAMO,
        {
            **_ANIMATION_LIMBS, "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2",
            "neck": "Neck", "head": "Head", "left_collar": "LeftShoulder", "right_collar": "RightShoulder",
        },
    ),
}  # fmt: skip

# All named maps.
JOINT_MAPS: Mapping[str, JointMap] = MappingProxyType(
    {name: JointMap.of(name, joints, given) for name, (joints, given) in _SKELETONS.items()}
)
