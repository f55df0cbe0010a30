"""Checked maps from any skeleton to the 22 joints, and those of skeletons that are known by name.

Missing joints follow from the proportions of the 22-joint skeleton. The ratios are means of two bodies: the mean pose
of HumanML3D (the public ``Mean.npy``), and the proportions of the synthetic people. Unit is the trunk, from the middle
of the hips to the middle of the shoulders, about 0.53 m in an adult. What each costs is measured in
``docs/wrapping.md``.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

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

# What completes the 22 joints, and the skeletons that are known by name; the file explains its columns.
_TABLES: Mapping[str, Any] = tomllib.loads(Path(__file__).with_name("named_skeletons.toml").read_text("utf-8"))

# Maps each joint that may be missing to the rule that makes it; each rule needs only joints of earlier ones.
COMPLETIONS: Mapping[Joint, Expression] = MappingProxyType(
    {Joint[name.upper()]: parse_expression(rule, NAMES, where=name) for name, rule in _TABLES["completions"].items()}
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


# The five kinematic chains of HumanML3D laid end to end, joints that two chains share standing in both.
_CHAIN_JOINTS = [NAMES[joint] for chain in CHAINS for joint in chain]
_CHAINS = [name if name not in _CHAIN_JOINTS[:place] else f"{name}_{place}" for place, name in enumerate(_CHAIN_JOINTS)]
_KNOWN = {"humanml3d-chains": _CHAINS, "xsens-23": XSENS_SEGMENTS}  # names that stand elsewhere


def _named(name: str, row: Mapping[str, Any]) -> JointMap:
    """Return the map of a row of the tables."""
    joints = row["joints"] if "joints" in row else _KNOWN[name]
    if isinstance(joints, int):
        joints = (*NAMES, *(f"joint_{index}" for index in range(N_JOINTS, joints)))
    given = dict(row.get("middle", {}))
    for part, text in row.get("sides", {}).items():
        for side in ("left", "right"):
            given[f"{side}_{part}"] = text.format(side=side, Side=side.capitalize(), S=side[0].upper())
    return JointMap.of(name, joints, given or {joint: joint for joint in NAMES})


# All named maps.
JOINT_MAPS: Mapping[str, JointMap] = MappingProxyType(
    {name: _named(name, row) for name, row in _TABLES["skeletons"].items()}
)
