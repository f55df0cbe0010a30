"""Checked maps from any skeleton to the 22 joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Num

from prbench.errors import InputFileError, UsageError, did_you_mean
from prbench.files.bounded import foreign_input, read_text
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.limits import HARMLESS_SIZE
from prbench.representation.converters.anatomy import (
    COMPLETIONS,
    LIMBS,
    NAMES,
    Expression,
    complete,
    parse_expression,
    placed,
    trunk_axes,
)

_KEYS = ("name", "joints", "map")
_TRUNK = (Joint.LEFT_HIP, Joint.RIGHT_HIP, Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER)


@dataclass(frozen=True)
class JointMap:
    """The 22 joints in terms of another skeleton's. Make one with :meth:`of`, which checks it."""

    name: str
    source_joints: tuple[str, ...]
    """Names of the source, in the order of its arrays."""
    expressions: Mapping[Joint, Expression]
    """Expressions of the joints that the source has."""

    @classmethod
    def of(cls, name: str, source_joints: Sequence[str], given: Mapping[str, str]) -> JointMap:
        """A checked map.

        Args:
            name: For messages.
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
                raise UsageError(
                    f"joint map '{name}', {joint.name.lower()}: hips and shoulders give the trunk its axes and cannot"
                    " themselves be offset along them."
                )
        return cls(name, names, expressions)

    @classmethod
    @foreign_input()
    def from_toml(cls, path: Path) -> JointMap:
        """A user's map: keys ``name``, ``joints`` (list of the source's names) and a table ``[map]``.

        Raises:
            InputFileError: if the file is missing, no TOML, or lacks a key.
            UsageError: as :meth:`of`.
        """
        import tomllib  # here, because Python before 3.11 has none, and programs of such a Python use this class

        try:
            content = tomllib.loads(read_text(path, encoding="utf-8", largest=HARMLESS_SIZE))
        except FileNotFoundError as error:
            raise InputFileError(path, "", expected="this file", found="no such file") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise InputFileError(path, "", expected="TOML", found=str(error)) from error
        unknown = [key for key in content if key not in _KEYS]
        if unknown:
            hint = did_you_mean(unknown[0], _KEYS).strip()
            raise InputFileError(path, unknown[0], expected=", ".join(_KEYS), found="another key", remedy=hint)
        joints = content.get("joints")
        given = content.get("map")
        if not isinstance(joints, list) or not all(isinstance(joint, str) for joint in joints):
            raise InputFileError(
                path, "joints", expected="a list of names, in the order of the arrays", found=f"{joints}"
            )
        if not isinstance(given, dict) or not all(isinstance(text, str) for text in given.values()):
            raise InputFileError(path, "[map]", expected='lines such as neck = "Neck"', found=f"{given}")
        return cls.of(str(content.get("name", path.stem)), joints, given)

    @property
    def completed(self) -> tuple[Joint, ...]:
        """Joints that the source lacks, and that are made from the others with fixed proportions."""
        return tuple(joint for joint in COMPLETIONS if joint not in self.expressions)

    def to_22(
        self, joints: Num[np.ndarray, "frames ..."], *, source: Path | str = "joints"
    ) -> Float[np.ndarray, "frames 22 3"]:
        """The 22 joints.

        Args:
            joints: (frames, joints of the source, 3): Y up, right-handed
                (:func:`prbench.representation.converters.to_y_up`), any unit.
            source: Name that messages begin with.

        Returns:
            Same world and unit; floating point.

        Raises:
            InputFileError: if the array has another number of joints.
        """
        if joints.ndim != 3 or joints.shape[1:] != (len(self.source_joints), 3):
            raise InputFileError(
                source,
                "",
                expected=f"(frames, {len(self.source_joints)}, 3) for the skeleton '{self.name}'",
                found=str(joints.shape),
                remedy="Name the skeleton that the joints are of (JOINT_MAPS), or write its map.",
            )
        native = joints.astype(np.float64)
        columns = {name: index for index, name in enumerate(self.source_joints)}
        body = np.full((len(joints), N_JOINTS, 3), np.nan)
        for joint in _TRUNK:
            body[:, joint] = placed(self.expressions[joint], columns, native, {})
        axes = trunk_axes(body)
        for joint, expression in self.expressions.items():
            body[:, joint] = placed(expression, columns, native, axes)
        return complete(body, self.completed).astype(np.result_type(joints.dtype, np.float32))
