"""``scripted``: what a motion with constant timing scores.

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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.contract import Motions
from prbench.harness.body_movements import (
    about_pelvis,
    glide,
    minimum_jerk,
    nod_to_goal,
    nodded,
    reaching,
    yaw_to_goal,
)

_ARRIVAL = 2.0  # s, the lead of every sequence before its prime time (docs/specification/curation.md#clip)
_TURN_DURATION = 1.0  # s
_SHORTEST_REACH = 0.5  # s


@dataclass(frozen=True)
class ScriptedStart:
    """The knowledge of the constant-timing control about B sequences; canonical frame, metres."""

    initial_joints: Float[np.ndarray, "batch 22 3"]
    goal_location: Float[np.ndarray, "batch 3"]
    head_tilt_deg: Float[np.ndarray, " batch"]


def scripted_motions(start: ScriptedStart, n_frames: Int[np.ndarray, " batch"], fps: float) -> Motions:
    """Make the motion of each sequence, which faces its goal at 2.0 s and then reaches it.

    Args:
        start: First pose, goal and tilt of the head of each sequence, canonical frame, metres.
        n_frames: Frames of each sequence.
        fps: Frame rate, in frames per second.

    Returns:
        Joints (batch, longest, 22, 3), canonical frame, metres, float32.
    """
    return Motions(scripted_joints(start, n_frames, fps).astype(np.float32), n_frames)


def scripted_joints(
    start: ScriptedStart, n_frames: Int[np.ndarray, " batch"], fps: float
) -> Float[np.ndarray, "batch frames 22 3"]:
    """The same motions as float64; canonical frame, metres. Frames beyond a sequence's own continue its end."""
    initial = start.initial_joints.astype(np.float64)
    goal = start.goal_location.astype(np.float64)
    turned = _turned_progress(n_frames, fps)
    reached = _reach_progress(n_frames, fps)

    yaw = yaw_to_goal(initial, goal, start.head_tilt_deg)
    nod = nod_to_goal(about_pelvis(initial[:, None], yaw[:, None])[:, 0], goal, start.head_tilt_deg)
    body = about_pelvis(initial[:, None], yaw[:, None] * turned)
    body = nodded(body, nod[:, None] * turned)
    body = body + reached[..., None, None] * glide(initial, goal)[:, None, None]
    return reaching(body, goal, reached)


def _turned_progress(n_frames: np.ndarray, fps: float) -> np.ndarray:
    time = np.arange(int(n_frames.max())) / fps
    # The turn ends at the arrival, so the ray is on the goal from 2.0 s on.
    turned = minimum_jerk((time - (_ARRIVAL - _TURN_DURATION)) / _TURN_DURATION)
    return np.broadcast_to(turned, (len(n_frames), len(time)))


def _reach_progress(n_frames: np.ndarray, fps: float) -> np.ndarray:
    time = np.arange(int(n_frames.max())) / fps
    end = ((n_frames - 1) / fps)[:, None]
    begin = np.clip(end - _SHORTEST_REACH, 0.0, _ARRIVAL)
    return minimum_jerk((time - begin) / np.maximum(end - begin, 1 / fps))
