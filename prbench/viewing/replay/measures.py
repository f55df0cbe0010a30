"""Distances of head, gaze and wrists from the goal, frame by frame, and the scores of a sequence in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.metrics.ray_track import ray_distance
from prbench.skeleton import WRISTS, Joint, head_forward
from prbench.viewing.replay.scene import Gaze, Goal, Scene, ShownMotion

HEADER = ("", "Prime\nSuccess", "Reach\nSuccess", "nearest\nwrist", "Location\nError", "Goal\nMPJPE", "MPJPE")
"""Header of the table of scores; "nearest wrist" is the smallest distance between a wrist and the goal."""


@dataclass(frozen=True, eq=False)
class Measures:
    """Measurements of one motion against the goal, one value a frame."""

    head_distance: Float[np.ndarray, " n"]
    """From the goal to the head-forward ray, metres; Prime Success compares it with its threshold."""
    head_angle: Float[np.ndarray, " n"]
    """Between the head-forward ray and the direction to the goal, degrees."""
    wrist_distance: Float[np.ndarray, " n"]
    """From the goal to the nearer wrist, metres."""

    @property
    def reach_distance(self) -> float:
        """The smallest distance of a wrist, metres; Reach Success compares it with its threshold."""
        return float(self.wrist_distance.min())


def measure(motion: ShownMotion, goal: Goal, head_tilt_deg: float) -> Measures:
    """Measure one motion.

    Sources: docs/specification/humanml3d.md#head-forward-vector, docs/specification/metrics.md#prime-success and
    docs/specification/metrics.md#reach-success.
    """
    head = motion.joints[:, Joint.HEAD]
    forward, _ = head_forward(motion.joints, head_tilt_deg)
    wrists = np.linalg.norm(motion.joints[:, list(WRISTS)] - goal.location, axis=2)
    return Measures(
        head_distance=ray_distance(head, forward, goal.location[None]),
        head_angle=_angle_deg(forward, goal.location - head),
        wrist_distance=wrists.min(axis=1),
    )


def gaze_distance(gaze: Gaze, goal: Goal) -> Float[np.ndarray, " n"]:
    """Return the distance of the goal from the recorded gaze ray, metres; NaN where the gaze is not valid."""
    distance = ray_distance(gaze.origin, gaze.direction, goal.location[None])
    return np.where(gaze.valid, distance, np.nan)


def gaze_angle(gaze: Gaze, goal: Goal) -> Float[np.ndarray, " n"]:
    """Return the angle of the recorded gaze to the direction of the goal, degrees; NaN where the gaze is not valid."""
    return np.where(gaze.valid, _angle_deg(gaze.direction, goal.location - gaze.origin), np.nan)


def _angle_deg(one: Float[np.ndarray, "n 3"], other: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    # The arc tangent stays exact for small angles, where an arc cosine loses half of its digits.
    sine = np.linalg.norm(np.cross(one, other), axis=1)
    return np.rad2deg(np.arctan2(sine, (one * other).sum(axis=1)))


def score_row(scene: Scene, motion: ShownMotion) -> tuple[str, ...]:
    """Return one row of the table, in the order of :data:`HEADER`; an en dash stands for an unknown value.

    The recorded motion gets no scores that would compare it with itself.
    """
    scores = motion.scores
    wrist = None if scene.goal is None else measure(motion, scene.goal, scene.head_tilt_deg).reach_distance
    recorded = motion is scene.motions[0] and scene.shows_recorded
    return (
        motion.label,
        _yes_no(scores.get("prime_success")),
        _yes_no(scores.get("reach_success")),
        _length(wrist),
        "–" if recorded else _yes_no(scores.get("location_error")),
        "–" if recorded else _length(scores.get("goal_mpjpe")),
        "–" if recorded else _length(scores.get("mpjpe")),
    )


def score_sentence(scene: Scene, motion: ShownMotion) -> str:
    """Return the known scores of a motion in one line."""
    names = (name.replace("\n", " ") for name in HEADER[1:])
    values = score_row(scene, motion)[1:]
    return ", ".join(f"{name} {value}" for name, value in zip(names, values, strict=True) if value != "–")


def verdict(scene: Scene, motion: ShownMotion) -> str:
    """Return the two main scores in a few words."""
    _, primed, reached, wrist, *_ = score_row(scene, motion)
    if primed == "–":
        return "not scored"
    return f"Prime Success {primed}, Reach Success {reached} ({wrist})"


def phase(scene: Scene, frame: int) -> str:
    """Name prime and event at the frames where they happen; the prime for a quarter of a second, so that it is seen."""
    if frame == scene.n_frames - 1:
        return f"{scene.action}  "
    since = frame / scene.fps - scene.prime_time
    return "prime  " if abs(since) <= 0.125 else ""


def _yes_no(rate: float | None) -> str:
    if rate is None:
        return "–"
    return "yes" if rate >= 0.5 else "no"


def _length(metres: float | None) -> str:
    if metres is None:
        return "–"
    return f"{metres * 100:.0f} cm" if metres < 0.995 else f"{metres:.2f} m"
