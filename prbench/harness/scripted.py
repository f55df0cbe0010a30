"""Controls that move by formula: ``scripted``, with constant timing, and the cheats.

Every sequence starts 2 s before its prime, so a motion that faces the goal at 2.0 s without looking at anything else
is a fair opponent. It knows the first pose and the goal, whatever the condition is, and does always the same:

1. Until 2.0 s the rigid body of the first frame turns about its pelvis until the head-forward ray points at the goal,
   and the head nods on the neck to the goal's height. Both follow a minimum-jerk curve over the second before, so the
   turn slows down as it arrives.
2. From 2.0 s to the last frame the body glides in a straight line until it stands 0.45 m before the goal (not at all
   if it already stands nearer), and over the same time the wrist that was nearer in the first frame moves to the goal.
   The elbow keeps both bones' lengths where the goal is within the arm's length of the shoulder; where it is not, the
   arm stretches, which bone_length_change shows.

The feet never step. Sequences that end less than half a second after 2.0 s begin the second part earlier.

The cheats earn scores without doing what the scores are meant to reward; ``docs/audit.md`` tells what they show.
Each knows the first pose, the goal and the head tilt, as ``scripted`` does, and is the same in every run. They are
controls, so that anybody can see what a metric is worth on a table, and are never ranked:

* ``stare``: the body of the first pose, turned so that the head-forward ray points at the goal. It never moves.
* ``tremor``: the same, with the head 0.1 mm further forward in every third frame.
* ``stare-late``: stands in the first pose, turns to the goal from 1.5 s to 2.0 s, and stares; no step, no reach.
* ``teleport``: stands in the first pose; from the frame at 2.0 s on it stands before the goal with a wrist on it.
* ``float``: rises 10 cm in the first half second, then turns, glides and reaches as ``scripted`` does.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import WRISTS, Joint, head_forward
from prbench.harness.methods.installed import FLOAT, STARE, STARE_LATE, TELEPORT, TREMOR

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
    squared = np.maximum((bone * bone).sum(axis=-1, keepdims=True), 1e-12)
    left = left - (left * bone).sum(axis=-1, keepdims=True) / squared * bone
    left = left / np.maximum(np.linalg.norm(left, axis=-1, keepdims=True), 1e-9)
    angle = -nod[..., None]  # a positive turn about the left axis looks down
    nodded = joints.copy()
    nodded[..., Joint.HEAD, :] = neck + bone * np.cos(angle) + np.cross(left, bone) * np.sin(angle)
    return nodded


def glide(joints: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Horizontal way of the body, (batch, 3)."""
    to_goal = goal - joints[:, Joint.PELVIS]
    # Over the ground only: the body keeps its height above the floor.
    to_goal[:, 1] = 0.0
    distance = np.linalg.norm(to_goal, axis=1, keepdims=True)
    return to_goal * np.clip(1 - _STAND_OFF / np.maximum(distance, 1e-9), 0.0, None)


def reaching(body: np.ndarray, goal: np.ndarray, progress: np.ndarray) -> np.ndarray:
    """Return the body with the wrist of one arm moved to the goal as ``progress`` goes from 0 to 1.

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


_ARRIVAL = 2.0  # s, the lead of every sequence before its prime time (docs/specification/curation.md#clip)
_TURN_DURATION = 1.0  # s
_SHORTEST_REACH = 0.5  # s


@dataclass(frozen=True)
class ScriptedStart:
    """The knowledge of the constant-timing control about B sequences; canonical frame, metres."""

    initial_joints: Float[np.ndarray, "batch 22 3"]
    goal_location: Float[np.ndarray, "batch 3"]
    head_tilt_deg: Float[np.ndarray, " batch"]


def scripted_joints(
    start: ScriptedStart, n_frames: Int[np.ndarray, " batch"], fps: float
) -> Float[np.ndarray, "batch frames 22 3"]:
    """Make the motion of each sequence, which faces its goal at 2.0 s and then reaches it.

    Args:
        start: First pose, goal and tilt of the head of each sequence, canonical frame, metres.
        n_frames: Frames of each sequence.
        fps: Frame rate, in frames per second.

    Returns:
        Joints, canonical frame, metres; frames beyond a sequence's own continue its end.
    """
    initial = start.initial_joints.astype(np.float64)
    goal = start.goal_location.astype(np.float64)
    time = _times(n_frames, fps)
    # The turn ends at the arrival, so the ray is on the goal from 2.0 s on.
    turned = minimum_jerk((time - (_ARRIVAL - _TURN_DURATION)) / _TURN_DURATION)
    turned = np.broadcast_to(turned, (len(n_frames), len(time)))
    end = ((n_frames - 1) / fps)[:, None]
    begin = np.clip(end - _SHORTEST_REACH, 0.0, _ARRIVAL)
    reached = minimum_jerk((time - begin) / np.maximum(end - begin, 1 / fps))
    body = _looking(start, turned)
    body = body + reached[..., None, None] * glide(initial, goal)[:, None, None]
    return reaching(body, goal, reached)


_LATE_TURN = 0.5  # s; a brisk turn of the head and body
_TREMOR = 1e-4  # m; far below what any recording resolves
_TREMOR_PERIOD = 3  # frames; with a period of two the turning speed would be the same in every frame
_RISE = 0.10  # m; twice the height of a foot that Foot Skating takes for standing
_RISE_DURATION = 0.5  # s

_Joints = Float[np.ndarray, "batch frames 22 3"]


def _stare(start: ScriptedStart, n_frames: np.ndarray, fps: float) -> _Joints:  # noqa: ARG001
    return _looking(start, np.ones((len(n_frames), int(n_frames.max()))))


def _tremor(start: ScriptedStart, n_frames: np.ndarray, fps: float) -> _Joints:
    joints = _stare(start, n_frames, fps)
    neck_to_head = joints[:, 0, Joint.HEAD] - joints[:, 0, Joint.NECK]
    left = joints[:, 0, Joint.LEFT_SHOULDER] - joints[:, 0, Joint.RIGHT_SHOULDER]
    # Across both bone and shoulders, so that the ray nods; a head that moves along its bone would not turn it.
    forward = np.cross(left, neck_to_head)
    forward = forward / np.maximum(np.linalg.norm(forward, axis=-1, keepdims=True), 1e-9)
    joints[:, ::_TREMOR_PERIOD, Joint.HEAD] += _TREMOR * forward[:, None]
    return joints


def _stare_late(start: ScriptedStart, n_frames: np.ndarray, fps: float) -> _Joints:
    time = _times(n_frames, fps)
    turned = minimum_jerk((time - (_ARRIVAL - _LATE_TURN)) / _LATE_TURN)
    return _looking(start, np.broadcast_to(turned, (len(n_frames), len(time))))


def _teleport(start: ScriptedStart, n_frames: np.ndarray, fps: float) -> _Joints:
    initial = start.initial_joints.astype(np.float64)
    goal = start.goal_location.astype(np.float64)
    time = _times(n_frames, fps)
    # A motion that ends before 2.0 s jumps in its last frame.
    jump = np.minimum(round(_ARRIVAL * fps), n_frames - 1)[:, None]
    there = (np.arange(len(time)) >= jump).astype(np.float64)
    body = _looking(start, there)
    # It stands before the goal first and looks then, so that the ray meets the goal from the new place.
    way = glide(initial, goal)
    moved = ScriptedStart(initial + way[:, None], goal, start.head_tilt_deg)
    arrived = _looking(moved, np.ones_like(there))
    body = np.where(there[..., None, None] > 0, arrived, body)
    return reaching(body, goal, there)


def _float(start: ScriptedStart, n_frames: np.ndarray, fps: float) -> _Joints:
    time = _times(n_frames, fps)
    height = np.zeros((len(time), 1, 3))
    height[:, 0, 1] = _RISE * minimum_jerk(time / _RISE_DURATION)
    # The goal is given to the formula 10 cm lower, so that the risen hand and eyes meet the true one.
    lower = ScriptedStart(start.initial_joints, start.goal_location - [0.0, _RISE, 0.0], start.head_tilt_deg)
    return scripted_joints(lower, n_frames, fps) + height


def _looking(start: ScriptedStart, turned: Float[np.ndarray, "batch frames"]) -> _Joints:
    """Return the rigid body of the first pose, turned and nodded to the goal by the given share."""
    initial = start.initial_joints.astype(np.float64)
    goal = start.goal_location.astype(np.float64)
    yaw = yaw_to_goal(initial, goal, start.head_tilt_deg)
    facing = about_pelvis(initial[:, None], yaw[:, None])[:, 0]
    nod = nod_to_goal(facing, goal, start.head_tilt_deg)
    body = about_pelvis(initial[:, None], yaw[:, None] * turned)
    return nodded(body, nod[:, None] * turned)


def _times(n_frames: np.ndarray, fps: float) -> Float[np.ndarray, " frames"]:
    return np.arange(int(n_frames.max())) / fps


# Maps the name of each cheat to what makes its motions, (batch, frames, 22, 3), canonical frame, metres.
CHEATS: Mapping[str, Callable[[ScriptedStart, np.ndarray, float], _Joints]] = {
    STARE: _stare,
    STARE_LATE: _stare_late,
    TREMOR: _tremor,
    TELEPORT: _teleport,
    FLOAT: _float,
}
