"""Checks that 22 joints can be a person's: left where left should be, limbs of human length.

Wrong units, exchanged sides and a wrong order of joints pass every check of shapes; these numbers show them. They are
refused here, before they become a score; ``prbench doctor`` looks at more.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.representation.clips import IN_MEMORY, check_finite
from prbench.representation.converters.axes import UNITS

_BEND = 0.01  # metres between knee and the line from hip to ankle; below it a leg says nothing about its front
_BACKWARDS = -0.3  # mean cosine between the front of the legs and that of the hips
_LIMB_LENGTHS = (0.12, 0.75)  # metres; thighs, shins and arms of children and of tall people
_ADULT_LIMB = 0.33  # metres, mean of the eight limbs
_TINIEST_BODY = 1e-9
_LIMB_RATIO = 1.6  # between a left limb and the right one


def check_limbs(joints: Float[np.ndarray, "frames 22 3"], *, source: Path | str = IN_MEMORY) -> None:
    """Refuse thighs, shins, upper arms and forearms that no person has.

    Args:
        joints: Metres, any axes.
        source: File or name that the message begins with.

    Raises:
        InputFileError: if a position is not finite, or there is none; if a limb is shorter than 12 cm or longer than
            75 cm in the median frame (with the unit that would explain it), or left and right differ by more than a
            factor of 1.6.
    """
    check_finite(joints, source)
    if not len(joints):
        raise InputFileError(source, "", expected="one frame or more", found="none")
    lengths = {limb: _median_length(joints, limb) for pair in _LIMB_PAIRS for limb in pair}
    _check_unit(lengths, source)
    for left, right in _LIMB_PAIRS:
        for limb in (left, right):
            if not _LIMB_LENGTHS[0] < lengths[limb] < _LIMB_LENGTHS[1]:
                raise _no_limb(
                    source, limb, f"{_LIMB_LENGTHS[0] * 100:.0f} to {_LIMB_LENGTHS[1] * 100:.0f} cm", lengths[limb]
                )
        if not 1 / _LIMB_RATIO < lengths[left] / lengths[right] < _LIMB_RATIO:
            raise _no_limb(source, left, f"about {lengths[right] * 100:.0f} cm, as on the right", lengths[left])


_LIMB_PAIRS = tuple((Joint[f"LEFT_{end}"], Joint[f"RIGHT_{end}"]) for end in ("KNEE", "ANKLE", "ELBOW", "WRIST"))
"""Joints in which thighs, shins, upper arms and forearms end."""


def _check_unit(lengths: dict[Joint, float], source: Path | str) -> None:
    """All limbs too long or too short by one factor: another unit."""
    factor = float(np.median(list(lengths.values()))) / _ADULT_LIMB
    if 1 / 3 < factor < 3:
        return
    if factor < _TINIEST_BODY:
        raise InputFileError(source, "", expected="joints of a body", found="joints that lie on one another")
    name = min(UNITS, key=lambda unit: abs(np.log(factor * UNITS[unit])))
    fits = 1 / 2 < factor * UNITS[name] < 2
    raise InputFileError(
        source,
        "unit",
        expected="a body in metres, whose thighs, shins and arms are 20 to 50 cm long",
        found=f"limbs {factor:.3g} times as long as an adult's",
        remedy=f"This looks like {name}: say unit='{name}'."
        if fits
        else f"If the model's bodies are normalised, unit={1 / factor:.3g} (metres a unit) makes them adults.",
    )


def _median_length(joints: np.ndarray, end: Joint) -> float:
    return float(np.median(np.linalg.norm(joints[:, end] - joints[:, PARENTS[end]], axis=-1)))


def _no_limb(source: Path | str, end: Joint, expected: str, length: float) -> InputFileError:
    bone = f"{Joint(PARENTS[end]).name.lower()} to {end.name.lower()}"
    return InputFileError(
        source,
        bone,
        expected=expected,
        found=f"{length * 100:.1f} cm in the median frame",
        remedy="The order of the joints is another one: name the skeleton (joint_map) and compare its list with yours.",
    )


def front_of_legs(joints: Float[np.ndarray, "frames 22 3"], *, feet: bool = True) -> float | None:
    """Measure how far feet and bent knees point to the front that hips and shoulders give.

    Args:
        joints: Y up, right-handed, metres.
        feet: False if the toes were computed from the hips, so that only the knees know.

    Returns:
        Mean cosine on the ground plane, 1 for a body that is in order, -1 where left and right are exchanged (or where
        a left-handed world was not said to be one); None if legs are straight throughout and feet are not asked.
    """
    across = joints[:, Joint.LEFT_HIP] - joints[:, Joint.RIGHT_HIP]
    across = across + joints[:, Joint.LEFT_SHOULDER] - joints[:, Joint.RIGHT_SHOULDER]
    front = np.stack([-across[:, 2], across[:, 0]], axis=-1)
    pointers = [_knee_bends(joints)]
    if feet:
        pointers += [joints[:, Joint.LEFT_FOOT] - joints[:, Joint.LEFT_ANKLE]]
        pointers += [joints[:, Joint.RIGHT_FOOT] - joints[:, Joint.RIGHT_ANKLE]]
    pointing = np.stack(pointers)[..., ::2]  # (pointers, frames, 2)
    length = np.linalg.norm(pointing, axis=-1)
    size = length * np.linalg.norm(front, axis=-1)
    decisive = length > _BEND
    if not decisive.any():
        return None
    cosine = (pointing * front).sum(axis=-1) / np.where(size > 0, size, 1.0)
    return float((cosine * length)[decisive].sum() / length[decisive].sum())


def check_sides(joints: Float[np.ndarray, "frames 22 3"], *, feet: bool = True, source: Path | str = IN_MEMORY) -> None:
    """Refuse a body whose feet and knees point to its back.

    Args:
        joints: Y up, right-handed, metres.
        feet: See :func:`front_of_legs`.
        source: File or name that the message begins with.

    Raises:
        InputFileError: if left and right are exchanged, or the world is left-handed.
    """
    cosine = front_of_legs(joints, feet=feet)
    if cosine is not None and cosine < _BACKWARDS:
        raise InputFileError(
            source,
            "left and right",
            expected="feet and knees that point to the body's front",
            found=f"a mean cosine of {cosine:.2f} between them and the front that hips and shoulders give",
            remedy="Left and right joints are exchanged, or the world is left-handed: check the order of the joints,"
            " then say left_handed=True.",
        )


def _knee_bends(joints: np.ndarray) -> np.ndarray:
    """Sum over both legs of the knee's offset from the line between hip and ankle (frames, 3)."""
    bends = np.zeros((len(joints), 3))
    for hip, knee, ankle in (
        (Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.LEFT_ANKLE),
        (Joint.RIGHT_HIP, Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE),
    ):
        leg = joints[:, ankle] - joints[:, hip]
        part = ((joints[:, knee] - joints[:, hip]) * leg).sum(axis=-1) / np.maximum((leg**2).sum(axis=-1), 1e-12)
        bends += joints[:, knee] - joints[:, hip] - part[:, None] * leg
    return bends
