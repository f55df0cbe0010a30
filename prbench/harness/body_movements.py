"""Movements of a rigid body that know nothing but a first pose and a goal: turn, nod, glide, reach.

The controls that move by formula are made of them (``scripted``, and the cheats of :mod:`prbench.harness.cheats`).
"""

from __future__ import annotations

import numpy as np

from prbench.geometry.skeleton import WRISTS, Joint, head_forward

_STAND_OFF = 0.45  # m between pelvis and goal on the ground: about an arm's length with a bent elbow
_STEEPEST_LOOK = np.deg2rad(75.0)  # above or below the horizon
_ARMS = ((Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, WRISTS[0]), (Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, WRISTS[1]))


def minimum_jerk(phase: np.ndarray) -> np.ndarray:
    """0 to 1 with speed and acceleration zero at both ends."""
    x = np.clip(phase, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def yaw_to_goal(joints: np.ndarray, goal: np.ndarray, head_tilt_deg: np.ndarray) -> np.ndarray:
    """Turn about the vertical through the pelvis after which the head-forward ray passes over or under the goal.

    The head is not above the pelvis: with l its offset to the side of the ray and r the goal's distance from the
    pelvis, the ray meets the goal when the goal stands asin(l / r) beside the forward direction.
    """
    forward, _ = head_forward(joints, head_tilt_deg)
    head = joints[:, Joint.HEAD] - joints[:, Joint.PELVIS]
    to_goal = goal - joints[:, Joint.PELVIS]
    distance = np.maximum(np.hypot(to_goal[:, 0], to_goal[:, 2]), 1e-6)
    heading = np.arctan2(forward[:, 0], forward[:, 2])
    # component of the head's offset along the direction at +90 degrees of yaw from forward
    beside = head[:, 0] * np.cos(heading) - head[:, 2] * np.sin(heading)
    yaw = np.arctan2(to_goal[:, 0], to_goal[:, 2]) - heading - np.arcsin(np.clip(beside / distance, -1.0, 1.0))
    return (yaw + np.pi) % (2 * np.pi) - np.pi


def nod_to_goal(joints: np.ndarray, goal: np.ndarray, head_tilt_deg: np.ndarray) -> np.ndarray:
    """Pitch of the head on the neck, upwards positive, that lifts the head-forward ray to the goal's height."""
    forward, _ = head_forward(joints, head_tilt_deg)
    elevation = np.arcsin(np.clip(forward[:, 1], -1.0, 1.0))
    nod = np.zeros(len(joints))
    for _ in range(3):  # the head moves a little as it nods
        to_goal = goal - nodded(joints[:, None], nod[:, None])[:, 0, Joint.HEAD]
        wanted = np.arctan2(to_goal[:, 1], np.hypot(to_goal[:, 0], to_goal[:, 2]))
        nod = np.clip(wanted, -_STEEPEST_LOOK, _STEEPEST_LOOK) - elevation
    return nod


def about_pelvis(joints: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """Joints (batch, 1, 22, 3) turned by yaw (batch, frames) about the vertical through the pelvis."""
    pelvis = joints[:, :, :1]
    cosine = np.cos(yaw)[..., None]
    sine = np.sin(yaw)[..., None]
    x, y, z = np.moveaxis(joints - pelvis, -1, 0)
    turned = np.stack(np.broadcast_arrays(x * cosine + z * sine, y, z * cosine - x * sine), axis=-1)
    return turned + pelvis


def nodded(joints: np.ndarray, nod: np.ndarray) -> np.ndarray:
    """Joints (batch, frames, 22, 3) with the head turned about the neck's shoulder axis, upwards positive."""
    neck = joints[..., Joint.NECK, :]
    bone = joints[..., Joint.HEAD, :] - neck
    left = joints[..., Joint.LEFT_SHOULDER, :] - joints[..., Joint.RIGHT_SHOULDER, :]
    left = left - _along(left, bone) * bone
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    angle = -nod[..., None]  # a positive turn about the left axis looks down
    nodded = joints.copy()
    nodded[..., Joint.HEAD, :] = neck + bone * np.cos(angle) + np.cross(left, bone) * np.sin(angle)
    return nodded


def _along(vectors: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return (vectors * axis).sum(axis=-1, keepdims=True) / np.maximum((axis * axis).sum(axis=-1, keepdims=True), 1e-12)


def glide(joints: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Horizontal way of the body, (batch, 3)."""
    to_goal = goal - joints[:, Joint.PELVIS]
    # Over the ground only: the body keeps its height above the floor.
    to_goal[:, 1] = 0.0
    distance = np.linalg.norm(to_goal, axis=1, keepdims=True)
    return to_goal * np.clip(1 - _STAND_OFF / np.maximum(distance, 1e-9), 0.0, None)


def reaching(body: np.ndarray, goal: np.ndarray, progress: np.ndarray) -> np.ndarray:
    """The body with the wrist of one arm moved to the goal as ``progress`` goes from 0 to 1.

    The arm is the one whose wrist is nearer in the first frame; once the body faces the goal, both are about as near.
    The hand's way is a straight line as seen from the body, so that the arm never lags behind while the body glides.
    """
    distances = [np.linalg.norm(body[:, 0, wrist] - goal, axis=1) for _, _, wrist in _ARMS]
    nearer = np.argmin(distances, axis=0)
    moved = body.copy()
    for side, (shoulder, elbow, wrist) in enumerate(_ARMS):
        rows = np.flatnonzero(nearer == side)
        share = progress[rows][..., None]
        hand = body[rows, :, wrist] + (goal[rows] - body[rows, -1, wrist])[:, None] * share
        arm = (body[rows, :, shoulder], body[rows, :, elbow], body[rows, :, wrist])
        moved[rows, :, elbow] = _elbow(*arm, hand, downwards=share)
        moved[rows, :, wrist] = hand
    return moved


def _elbow(
    shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray, hand: np.ndarray, *, downwards: np.ndarray
) -> np.ndarray:
    """Place the elbow for a wrist at ``hand``: both bones keep their lengths if that is possible.

    It bends to the side on which it was, and the more downwards the further the reach has got (``downwards`` from 0 to
    1, which decides for an arm that was straight); beyond the arm's length both bones are stretched in proportion.
    """
    upper = np.linalg.norm(elbow - shoulder, axis=-1, keepdims=True)
    lower = np.linalg.norm(wrist - elbow, axis=-1, keepdims=True)
    reach = hand - shoulder
    distance = np.maximum(np.linalg.norm(reach, axis=-1, keepdims=True), 1e-6)
    direction = reach / distance
    side = (elbow - shoulder) + downwards * np.array([0.0, -0.05, 0.0])
    side = side - (side * direction).sum(axis=-1, keepdims=True) * direction
    side = side / np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9)
    bent = np.clip(distance, np.abs(upper - lower), upper + lower)
    along = (bent**2 + upper**2 - lower**2) / (2 * np.maximum(bent, 1e-6))
    height = np.sqrt(np.maximum(upper**2 - along**2, 0.0))
    along = np.where(distance > upper + lower, distance * upper / np.maximum(upper + lower, 1e-6), along)
    return shoulder + direction * along + side * height
