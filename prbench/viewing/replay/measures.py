"""How near head, gaze and wrists come to the goal, frame by frame: the curves under the figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.metrics.ray_track import ray_distance
from prbench.skeleton import WRISTS, Joint, head_forward
from prbench.viewing.replay.scene import Gaze, Goal, ShownMotion


@dataclass(frozen=True, eq=False)
class Measures:
    """Of one motion against the goal, one value a frame."""

    head_distance: Float[np.ndarray, " n"]
    """From the goal to the head-forward ray, metres: what Prime Success compares with its threshold."""
    head_angle: Float[np.ndarray, " n"]
    """Between the head-forward ray and the direction to the goal, degrees."""
    wrist_distance: Float[np.ndarray, " n"]
    """From the goal to the nearer wrist, metres."""

    @property
    def reach_distance(self) -> float:
        """The smallest distance of a wrist, metres: what Reach Success compares with its threshold."""
        return float(self.wrist_distance.min())


def measure(motion: ShownMotion, goal: Goal, head_tilt_deg: float) -> Measures:
    """Measure one motion.

    Sources: docs/specification/humanml3d.md#head-forward-vector, docs/specification/metrics.md#prime-success and
    docs/specification/metrics.md#reach-success.
    """
    head = motion.joints[:, Joint.HEAD]
    forward, _ = head_forward(motion.joints, head_tilt_deg)
    to_goal = goal.location - head
    sine = np.linalg.norm(np.cross(forward, to_goal), axis=1)
    cosine = (forward * to_goal).sum(axis=1)
    wrists = np.linalg.norm(motion.joints[:, list(WRISTS)] - goal.location, axis=2)
    return Measures(
        head_distance=ray_distance(head, forward, goal.location[None]),
        head_angle=np.rad2deg(np.arctan2(sine, cosine)),
        wrist_distance=wrists.min(axis=1),
    )


def gaze_distance(gaze: Gaze, goal: Goal) -> Float[np.ndarray, " n"]:
    """From the goal to the recorded gaze ray, metres; NaN where the gaze is not valid."""
    distance = ray_distance(gaze.origin, gaze.direction, goal.location[None])
    return np.where(gaze.valid, distance, np.nan)


def gaze_angle(gaze: Gaze, goal: Goal) -> Float[np.ndarray, " n"]:
    """Between the recorded gaze ray and the direction to the goal, degrees; NaN where the gaze is not valid."""
    to_goal = goal.location - gaze.origin
    sine = np.linalg.norm(np.cross(gaze.direction, to_goal), axis=1)
    angle = np.rad2deg(np.arctan2(sine, (gaze.direction * to_goal).sum(axis=1)))
    return np.where(gaze.valid, angle, np.nan)
