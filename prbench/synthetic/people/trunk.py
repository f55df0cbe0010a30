"""Forward kinematics of pelvis, spine, neck, hips and shoulders.

Heading and lean are spread over the spine: the pelvis takes .4 of the lean, the three spine segments a third each of
the rest (docs/specification/synthetic-recordings.md#reaching-and-holding). Everything broadcasts over leading axes
(frames, grid cells).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.synthetic.people.geometry import turn
from prbench.synthetic.people.person import Body

PELVIS_SHARE_OF_LEAN = 0.4
STANDING_LEG = 0.990
"""Hip height above the ankle when standing, share of the leg: a knee of 164 degrees."""
BALL_HEIGHT = 0.013
"""Ball of the resting foot above the floor, metres."""


@dataclass(frozen=True)
class Trunk:
    """Positions in metres, world frame; yaw and pitch of the segments in radians."""

    pelvis: np.ndarray
    hips: tuple[np.ndarray, np.ndarray]
    spine: tuple[np.ndarray, np.ndarray, np.ndarray]
    neck: np.ndarray
    collars: tuple[np.ndarray, np.ndarray]
    shoulders: tuple[np.ndarray, np.ndarray]
    yaws: tuple[np.ndarray, ...]
    """Pelvis, spine1, spine2, spine3 (the chest)."""
    pitches: tuple[np.ndarray, ...]


def pose_trunk(
    body: Body,
    stoop: float,
    pelvis: np.ndarray,
    pelvis_yaw: np.ndarray | float,
    chest_yaw: np.ndarray | float,
    lean: np.ndarray | float,
) -> Trunk:
    """Place the trunk's joints.

    Args:
        body: Bone offsets.
        stoop: Constant extra lean of the spine, radians.
        pelvis: Positions (..., 3).
        pelvis_yaw: Heading of the pelvis.
        chest_yaw: Heading of the chest, not wrapped against the pelvis.
        lean: Forward lean of the chest without the stoop.
    """
    lean = np.asarray(lean, dtype=np.float64)
    twist = np.asarray(chest_yaw) - pelvis_yaw
    bend = (1.0 - PELVIS_SHARE_OF_LEAN) * lean + stoop
    yaws = tuple(np.asarray(pelvis_yaw + twist * third / 3.0) for third in range(4))
    pitches = tuple(PELVIS_SHARE_OF_LEAN * lean + bend * third / 3.0 for third in range(4))
    joints = [pelvis]
    for yaw, pitch, offset in zip(yaws, pitches, body.spine, strict=True):
        joints.append(joints[-1] + turn(yaw, pitch, np.array(offset)))
    _, spine1, spine2, spine3, neck = joints
    collars = tuple(spine3 + turn(yaws[3], pitches[3], _mirrored(body.collar, side)) for side in (0, 1))
    shoulders = tuple(
        collar + turn(yaws[3], pitches[3], _mirrored(body.shoulder, side)) for side, collar in enumerate(collars)
    )
    hips = tuple(pelvis + turn(yaws[0], pitches[0], _mirrored(body.hip, side)) for side in (0, 1))
    return Trunk(
        pelvis,
        (hips[0], hips[1]),
        (spine1, spine2, spine3),
        neck,
        (collars[0], collars[1]),
        (shoulders[0], shoulders[1]),
        yaws,
        pitches,
    )


def standing_pelvis_height(body: Body) -> float:
    """Pelvis height of a person who stands upright."""
    return BALL_HEIGHT + body.ankle_height + STANDING_LEG * body.leg - body.hip[1]


def seated_pelvis_height(body: Body) -> float:
    """Pelvis height of a person who sits."""
    return 0.34 * body.stature


def _mirrored(offset: tuple[float, float, float], side: int) -> np.ndarray:
    return np.array([offset[0] if side == 0 else -offset[0], offset[1], offset[2]])
