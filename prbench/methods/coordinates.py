"""Coordinates that no motion in metres holds: refused with frame and joint, and with the unit that they look like."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from prbench.limits import FARTHEST_COORDINATE
from prbench.methods.body_size import spread_poses, wrong_unit
from prbench.skeleton import Joint


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
