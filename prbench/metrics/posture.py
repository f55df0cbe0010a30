"""Posture: how far joints bend, how the body stands when it comes to its goal, and how fast it turns."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint
from prbench.metrics.batch import ScoringPair

# Name of each bend: pairs of bones, (from, to) each, between which it is the largest angle; 0 for straight ones.
_Bone = tuple[Joint, Joint]
_HIPS = (Joint.RIGHT_HIP, Joint.LEFT_HIP)
_SHOULDERS = (Joint.RIGHT_SHOULDER, Joint.LEFT_SHOULDER)
_FEET = ((Joint.LEFT_ANKLE, Joint.LEFT_FOOT), (Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT))
_BENDS: dict[str, tuple[tuple[_Bone, _Bone], ...]] = {
    "knee": (
        ((Joint.LEFT_HIP, Joint.LEFT_KNEE), (Joint.LEFT_KNEE, Joint.LEFT_ANKLE)),
        ((Joint.RIGHT_HIP, Joint.RIGHT_KNEE), (Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE)),
    ),
    "elbow": (
        ((Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW), (Joint.LEFT_ELBOW, Joint.LEFT_WRIST)),
        ((Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW), (Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST)),
    ),
    "ankle": (
        ((Joint.LEFT_KNEE, Joint.LEFT_ANKLE), (Joint.LEFT_ANKLE, Joint.LEFT_FOOT)),
        ((Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE), (Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT)),
    ),
    "hip": (
        ((Joint.SPINE1, Joint.PELVIS), (Joint.LEFT_HIP, Joint.LEFT_KNEE)),
        ((Joint.SPINE1, Joint.PELVIS), (Joint.RIGHT_HIP, Joint.RIGHT_KNEE)),
    ),
    "spine": (((Joint.PELVIS, Joint.SPINE1), (Joint.SPINE3, Joint.NECK)),),
    "neck": (((Joint.SPINE3, Joint.NECK), (Joint.NECK, Joint.HEAD)),),
}


def posture_numbers(pair: ScoringPair) -> dict[str, Float[np.ndarray, " n"]]:
    """Measure the postures of each predicted motion (docs/specification/metrics.md#posture).

    Args:
        pair: Predicted motions, canonical frame, metres, two frames or more, with their goals.

    Returns:
        * ``knee``, ``elbow``, ``ankle``, ``hip``, ``spine``, ``neck``: largest bend, degrees; 0 is straight, and a
          neck at rest has 0.
        * ``toe_out``: largest turn of a foot against the hips about the vertical, degrees.
        * ``twist``: largest turn of the shoulders against the hips about the trunk, degrees; ``twisting``: its largest
          speed, degrees a second.
        * ``turning``, ``bowing``, ``nodding``: largest speed at which hips or shoulders turn about the vertical, and at
          which the lines from pelvis to neck and from neck to head turn, degrees a second.
        * ``tilt_at_goal``: tilt of the trunk, degrees, in the frame in which a wrist is nearest to a goal that is
          higher than the knees; 0 for lower goals.
        * ``head_under_goal``: height of the goal above the head in that frame, metres; less than 0 for lower goals.
    """
    motion = pair.predicted
    joints = motion.columns

    def largest(values: Float[np.ndarray, " frames"]) -> Float[np.ndarray, " n"]:
        return np.maximum.reduceat(values, motion.first)

    found = {}
    for name, bones in _BENDS.items():
        bends = [_angle(joints[b] - joints[a], joints[d] - joints[c]) for (a, b), (c, d) in bones]
        found[name] = largest(np.max(bends, axis=0))
    lines = [joints[left] - joints[right] for right, left in (_HIPS, _SHOULDERS)]
    left_x, _, left_z = lines[0]
    ahead = np.stack([-left_z, np.zeros_like(left_x), left_x])
    feet = [joints[toe] - joints[ankle] for ankle, toe in _FEET]
    level = np.array([[1.0], [0.0], [1.0]])
    found["toe_out"] = largest(np.max([_angle(ahead, foot * level) for foot in feet], axis=0))
    trunk = joints[Joint.NECK] - joints[Joint.PELVIS]
    # The parts of both lines across the trunk: what is left of their angle is the turn about it.
    squared = np.maximum((trunk * trunk).sum(axis=0), 1e-12)
    across = [line - (line * trunk).sum(axis=0) / squared * trunk for line in lines]
    twist = _angle(*across)
    found["twist"] = largest(twist)
    found["twisting"] = _fastest(np.abs(np.diff(twist)), pair)
    speeds = [_fastest(_angle((line * level)[:, :-1], (line * level)[:, 1:]), pair) for line in lines]
    found["turning"] = np.max(speeds, axis=0)
    found["bowing"] = _fastest(_angle(trunk[:, :-1], trunk[:, 1:]), pair)
    head = joints[Joint.HEAD] - joints[Joint.NECK]
    found["nodding"] = _fastest(_angle(head[:, :-1], head[:, 1:]), pair)
    found["neck"] -= pair.targets.head_tilt_deg
    # The frame in which a wrist is nearest to the goal.
    goal = pair.targets.goal_location.T[:, motion.sequence_of_row]
    distance = np.sqrt(((joints[list(WRISTS)] - goal) ** 2).sum(axis=1)).min(axis=0)
    nearest = np.array([np.argmin(part) for part in np.split(distance, motion.first[1:])]) + motion.first
    up = np.array([[0.0], [1.0], [0.0]])
    tilt = _angle(trunk[:, nearest], np.broadcast_to(up, trunk[:, nearest].shape))
    height = pair.targets.goal_location[:, 1]
    knees = joints[[Joint.LEFT_KNEE, Joint.RIGHT_KNEE], 1].mean(axis=0)[nearest]
    found["tilt_at_goal"] = np.where(height > knees, tilt, 0.0)
    found["head_under_goal"] = height - joints[Joint.HEAD, 1, nearest]
    return found


def _angle(first: Float[np.ndarray, "3 frames"], second: Float[np.ndarray, "3 frames"]) -> Float[np.ndarray, " frames"]:
    """Angle between two vectors, degrees; 0 where one has no length."""
    cross = np.cross(first, second, axis=0)
    return np.rad2deg(np.arctan2(np.sqrt((cross * cross).sum(axis=0)), (first * second).sum(axis=0)))


def _fastest(turns: Float[np.ndarray, " frames_but_one"], pair: ScoringPair) -> Float[np.ndarray, " n"]:
    """Return the largest turn from a frame to the next one of the same sequence, degrees a second."""
    motion = pair.predicted
    turn = np.append(turns, 0.0)
    turn[motion.last] = 0.0
    return np.maximum.reduceat(turn, motion.first) * pair.targets.fps_of_sequence
