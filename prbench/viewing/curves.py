"""Numbers over time that show how a prime-and-reach sequence unfolds, and which a plot puts under its figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.metrics.ray_track import ray_distance
from prbench.skeleton import WRISTS, Joint, head_forward
from prbench.synthetic.performance import Performance, TrueEvent

_STEP = 0.025  # seconds between the points of a curve


@dataclass(frozen=True)
class Curves:
    """From before the prime time to the event. Metres, seconds, degrees; times relative to the event."""

    times: Float[np.ndarray, " n"]
    gaze_distance: Float[np.ndarray, " n"]
    """Goal to the true gaze ray."""
    head_distance: Float[np.ndarray, " n"]
    """Goal to the head-forward ray of the joints."""
    wrist_distance: Float[np.ndarray, " n"]
    wrist_speed: Float[np.ndarray, " n"]
    pelvis_speed: Float[np.ndarray, " n"]
    pelvis_height: Float[np.ndarray, " n"]
    head_rate: Float[np.ndarray, " n"]


def curves_of(performance: Performance, event: TrueEvent, start: float, end: float) -> Curves:
    """Measure one event of a performance between two times of the recording.

    Args:
        performance: Noise-free motion and gaze.
        event: Whose goal and hand are meant.
        start: First time, seconds.
        end: Last time, seconds.
    """
    stride = max(1, round(_STEP * performance.rate))
    first, last = np.searchsorted(performance.times, [start, end])
    frames = np.arange(int(first), min(int(last) + 1, performance.times.size), stride)
    joints, times = performance.joints[frames], performance.times[frames]
    forward, _ = head_forward(joints, performance.person.neck_tilt_deg)
    wrist = joints[:, WRISTS[event.hand == "right"]]
    turning = np.arccos(np.clip((forward[1:] * forward[:-1]).sum(axis=1), -1.0, 1.0))
    return Curves(
        times=times - event.event_time,
        gaze_distance=ray_distance(performance.eye[frames], performance.gaze[frames], event.goal[None]),
        head_distance=ray_distance(joints[:, Joint.HEAD], forward, event.goal[None]),
        wrist_distance=np.linalg.norm(wrist - event.goal, axis=1),
        wrist_speed=_speed(wrist, times),
        pelvis_speed=_speed(joints[:, Joint.PELVIS], times),
        pelvis_height=joints[:, Joint.PELVIS, 1],
        head_rate=np.rad2deg(np.concatenate([[0.0], turning]) / (times[1] - times[0])),
    )


def _speed(points: np.ndarray, times: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.gradient(points, times, axis=0), axis=1)
