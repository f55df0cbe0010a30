"""Distances of head, gaze and wrists from the goal, frame by frame, and the scores of a sequence in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint, head_forward
from prbench.metrics import STUDY_METRICS, MetricInfo
from prbench.metrics.ray_track import ray_distance
from prbench.viewing.replay.scene import Gaze, Goal, Scene, ShownMotion

# Rates are shown as yes or no, metres as lengths; a ratio such as Foot Skating says little of one sequence.
_SHOWN = sorted((info for info in STUDY_METRICS if info.unit in ("rate", "m")), key=lambda i: i.unit != "rate")
_OF_ONE_MOTION = tuple(info for info in _SHOWN if not info.compares_with_recorded)
_OF_TWO_MOTIONS = tuple(info for info in _SHOWN if info.compares_with_recorded)
HEADER = (
    "",
    *(info.title.replace(" ", "\n") for info in _OF_ONE_MOTION),
    "nearest\nwrist",
    *(info.title.replace(" ", "\n") for info in _OF_TWO_MOTIONS),
)
"""Header of the table of scores; "nearest wrist" is the smallest distance between a wrist and the goal."""
_UNKNOWN = "–"


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
    wrist = None if scene.goal is None else measure(motion, scene.goal, scene.head_tilt_deg).reach_distance
    recorded = motion is scene.motions[0] and scene.shows_recorded
    return (
        motion.label,
        *(_cell(info, motion) for info in _OF_ONE_MOTION),
        _length(wrist),
        *(_UNKNOWN if recorded else _cell(info, motion) for info in _OF_TWO_MOTIONS),
    )


def score_sentence(scene: Scene, motion: ShownMotion) -> str:
    """Return the known scores of a motion in one line."""
    names = (name.replace("\n", " ") for name in HEADER[1:])
    values = score_row(scene, motion)[1:]
    return ", ".join(f"{name} {value}" for name, value in zip(names, values, strict=True) if value != _UNKNOWN)


def verdict(scene: Scene, motion: ShownMotion) -> str:
    """Return the two main scores in a few words."""
    _, *cells = score_row(scene, motion)
    if cells[0] == _UNKNOWN:
        return "not scored"
    scores = ", ".join(f"{info.title} {cell}" for info, cell in zip(_OF_ONE_MOTION, cells))
    return f"{scores} ({cells[len(_OF_ONE_MOTION)]})"


def phase(scene: Scene, frame: int) -> str:
    """Name prime and event at the frames where they happen; the prime for a quarter of a second, so that it is seen."""
    if frame == scene.n_frames - 1:
        return f"{scene.action}  "
    since = frame / scene.fps - scene.prime_time
    return "prime  " if abs(since) <= 0.125 else ""


def _cell(info: MetricInfo, motion: ShownMotion) -> str:
    value = motion.scores.get(info.id)
    if info.unit != "rate" or value is None:
        return _length(value)
    return "yes" if value >= 0.5 else "no"


def _length(metres: float | None) -> str:
    if metres is None:
        return _UNKNOWN
    return f"{metres * 100:.0f} cm" if metres < 0.995 else f"{metres:.2f} m"
