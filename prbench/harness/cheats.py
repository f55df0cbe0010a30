"""Motions that earn scores without doing what the scores are meant to reward; ``docs/audit.md`` tells what they show.

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

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import Motions
from prbench.geometry.skeleton import Joint
from prbench.harness.body_movements import (
    about_pelvis,
    glide,
    minimum_jerk,
    nod_to_goal,
    nodded,
    reaching,
    yaw_to_goal,
)
from prbench.harness.methods.installed import FLOAT, STARE, STARE_LATE, TELEPORT, TREMOR
from prbench.harness.scripted import ScriptedStart, scripted_joints

_ARRIVAL = 2.0  # s, the lead of every sequence before its prime time (docs/specification/curation.md#clip)
_LATE_TURN = 0.5  # s; a brisk turn of the head and body
_TREMOR = 1e-4  # m; far below what any recording resolves
_TREMOR_PERIOD = 3  # frames; with a period of two the turning speed would be the same in every frame
_RISE = 0.10  # m; twice the height of a foot that Foot Skating takes for standing
_RISE_DURATION = 0.5  # s

_Joints = Float[np.ndarray, "batch frames 22 3"]


def cheating_motions(name: str, start: ScriptedStart, n_frames: Int[np.ndarray, " batch"], fps: float) -> Motions:
    """Return the motions of one cheat.

    Args:
        name: A key of :data:`CHEATS`.
        start: First poses, goals and head tilts; canonical frame, metres.
        n_frames: Frames of each sequence.
        fps: Frames per second.
    """
    joints = CHEATS[name](start, n_frames, fps)
    return Motions(joints.astype(np.float32), n_frames)


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
    """The rigid body of the first pose, turned and nodded to the goal by the given share."""
    initial = start.initial_joints.astype(np.float64)
    goal = start.goal_location.astype(np.float64)
    yaw = yaw_to_goal(initial, goal, start.head_tilt_deg)
    facing = about_pelvis(initial[:, None], yaw[:, None])[:, 0]
    nod = nod_to_goal(facing, goal, start.head_tilt_deg)
    body = about_pelvis(initial[:, None], yaw[:, None] * turned)
    return nodded(body, nod[:, None] * turned)


def _times(n_frames: np.ndarray, fps: float) -> Float[np.ndarray, " frames"]:
    return np.arange(int(n_frames.max())) / fps


CHEATS: Mapping[str, Callable[[ScriptedStart, np.ndarray, float], _Joints]] = {
    STARE: _stare,
    STARE_LATE: _stare_late,
    TREMOR: _tremor,
    TELEPORT: _teleport,
    FLOAT: _float,
}
"""Maps the name of each cheat to what makes its motions, (batch, frames, 22, 3), canonical frame, metres."""
