"""Coordinates that no motion in metres holds, refused with frame and joint, and the unit that a body seems to be in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import Joint
from prbench.limits import FARTHEST_COORDINATE, FARTHEST_EYES

_SMALLEST = 0.65  # metres between the two joints of a human pose that lie farthest apart
_TYPICAL = 1.5
_LARGEST = 2.35
_NO_BODY = 1e-9
_UNIT_WITHIN = 0.01  # by which a direction's length may differ from 1, such as after rounding to half precision
_POSES_PER_MOTION = 48
_UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254), ("decimetres", 0.1), ("feet", 0.3048))


class WrongUnit(NamedTuple):
    """Bodies that are not of human size in metres."""

    evidence: str
    cause: str
    remedy: str
    metres_per_unit: float
    """Factor that the numbers have to be multiplied by."""


def spread_poses(motion: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "poses joints 3"]:
    """Return at most 48 poses of a motion, evenly spread over its frames."""
    return motion[np.linspace(0, len(motion) - 1, min(len(motion), _POSES_PER_MOTION)).astype(int)]


def wrong_unit(poses: Float[np.ndarray, "poses joints 3"]) -> WrongUnit | None:
    """Return the unit that bodies seem to be in, or None where they are of human size in metres or have no size.

    Axes and the order of joints do not matter.
    """
    size = _body_size(poses)
    if size < _NO_BODY or _SMALLEST <= size <= _LARGEST:
        return None
    evidence = f"the joints of a pose lie up to {size:.4g} apart (median); those of people 0.65 to 2.35 m"
    # Several units may fit; the one that makes the body most usual wins.
    fits = [unit for unit in _UNITS if _SMALLEST <= size * unit[1] <= _LARGEST]
    if fits:
        name, factor = min(fits, key=lambda unit: abs(np.log(size * unit[1] / _TYPICAL)))
        cause = f"positions are in {name}"
        remedy = f"Multiply the joints by {factor:g}: prbench wants metres."
    else:
        factor = _TYPICAL / size
        cause = "positions were divided by a height or a standard deviation, or are in a unit of their own"
        remedy = f"Undo the scaling before the motions are handed over; a factor near {factor:.3g} gives people's size."
    return WrongUnit(evidence, cause, remedy, factor)


def _body_size(poses: Float[np.ndarray, "poses joints 3"]) -> float:
    """Return the median over poses of the largest distance between two joints, in the unit of the poses."""
    apart = np.linalg.norm(poses[:, :, None] - poses[:, None], axis=-1)
    return float(np.median(apart.max(axis=(1, 2))))


def impossible_frames(
    joints: Float[np.ndarray, "*frames 22 3"], farthest: float = FARTHEST_COORDINATE
) -> Bool[np.ndarray, "*frames"]:
    """Return True for each frame with a coordinate that is not finite, or farther out than any motion goes.

    Args:
        joints: In metres.
        farthest: Metres from the origin; infinity to look for what is not finite alone.
    """
    return np.logical_not(_possible(joints, farthest).all(axis=(-2, -1)))


def coordinate_problem(motion: Float[np.ndarray, "frames 22 3"], farthest: float = FARTHEST_COORDINATE) -> str | None:
    """Say where a motion holds an impossible coordinate, and what its numbers look like.

    Args:
        motion: All frames of one motion, as it was handed in.
        farthest: See :func:`impossible_frames`.

    Returns:
        ``frame …`` and the rest of a message, or None if all coordinates are possible.
    """
    frames = np.flatnonzero(impossible_frames(motion, farthest))
    if not frames.size:
        return None
    frame = int(frames[0])
    joint = int(np.flatnonzero(~_possible(motion[frame], farthest).all(axis=1))[0])
    found = ", ".join(f"{value:.6g}" for value in motion[frame, joint])
    if not np.isfinite(motion[frame, joint]).all():
        expected = "finite positions"
    else:
        expected = f"coordinates within {farthest:g} m of the origin"
    name = Joint(joint).name.lower().replace("_", " ")
    return f"frame {frame}: expected {expected}, found [{found}] at joint {joint} ({name}).{_unit(motion)}"


def gaze_problem(
    motion: Float[np.ndarray, "frames 22 3"],
    origin: Float[np.ndarray, "frames 3"],
    direction: Float[np.ndarray, "frames 3"],
) -> str | None:
    """Say where gaze is no ray from a head.

    Args:
        motion: The joints of the same frames, metres.
        origin: Between the eyes, same frame and unit.
        direction: Of the ray.

    Returns:
        ``frame …`` and the rest of a message, or None if every frame has a ray from its head.
    """
    away = np.linalg.norm(origin - motion[:, Joint.HEAD], axis=-1)
    length = np.linalg.norm(direction, axis=-1)
    # Written as "not within", so that NaN counts as wrong.
    elsewhere = ~(away <= FARTHEST_EYES)
    no_unit = ~(np.abs(length - 1) <= _UNIT_WITHIN)
    wrong = np.flatnonzero(elsewhere | no_unit)
    if not wrong.size:
        return None
    frame = int(wrong[0])
    if elsewhere[frame]:
        return (
            f"frame {frame}: expected eyes within {FARTHEST_EYES:g} m of the head joint, found them {away[frame]:.3g} m"
            " away. Gaze stands in the frame of the joints, in metres."
        )
    return (
        f"frame {frame}: expected a gaze direction of length 1, found {length[frame]:.4g}. Divide each by its length."
    )


def _possible(values: np.ndarray, farthest: float) -> np.ndarray:
    """Return True for each number that is finite and within the distance."""
    return np.isfinite(values) & (np.abs(values) <= farthest)


def _unit(motion: np.ndarray) -> str:
    """Say which unit the size of the body looks like; nothing where it is human or holds values that are not finite."""
    if not np.isfinite(motion).all():
        return ""
    found = wrong_unit(spread_poses(motion.astype(np.float64)))
    if found is None:
        return ""
    return f" {found.evidence[0].upper()}{found.evidence[1:]}: {found.cause}. {found.remedy}"
