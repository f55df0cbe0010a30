"""The six metrics of one sequence, one frame and joint at a time: what the vectorised ones are timed against."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from prbench.geometry.skeleton import TOES, WRISTS, Joint, head_forward
from prbench.protocol.manifests import MetricConstants


def naive_metrics(
    predicted: np.ndarray,
    recorded: np.ndarray,
    goal: np.ndarray,
    *,
    prime_time: float,
    head_tilt_deg: float,
    fps: float,
    constants: MetricConstants,
) -> dict[str, float]:
    """All six, by the metric's id; joints (n, 22, 3), goal (3,), canonical frame, metres, seconds."""
    distances = [[np.linalg.norm(p - r) for p, r in zip(*frames, strict=True)] for frames in zip(predicted, recorded)]
    reach = min(np.linalg.norm(frame[wrist] - goal) for frame in predicted for wrist in WRISTS)
    return {
        "prime_success": _prime_success(predicted, goal, prime_time, head_tilt_deg, fps, constants),
        "reach_success": float(reach <= constants.reach_distance),
        "goal_mpjpe": float(np.mean(distances[-1])),
        "location_error": float(distances[-1][Joint.PELVIS] >= constants.location_error_distance),
        "mpjpe": float(np.mean(distances)),
        "foot_skating": _foot_skating(predicted, fps, constants),
    }


def _prime_success(joints, goal, prime_time, head_tilt_deg, fps, constants) -> float:
    forward, on_target = [], []
    for frame in joints:
        direction, degenerate = head_forward(frame[None], head_tilt_deg)
        offset = goal - frame[Joint.HEAD]
        distance = np.linalg.norm(offset - max(float(offset @ direction[0]), 0.0) * direction[0])
        forward.append(direction[0])
        on_target.append(distance <= constants.prime_distance and not degenerate[0])
    speed = [0.0]
    for before, after in pairwise(forward):
        speed.append(fps * np.arctan2(np.linalg.norm(np.cross(before, after)), before @ after))
    hold = int(np.ceil(constants.prime_duration * fps - 1e-9))
    for t in range(2, len(joints) - hold):
        near_prime_time = abs(t / fps - prime_time) <= constants.prime_window + 1e-9
        slows_down = speed[t] - speed[t - 1] < -constants.deceleration_tolerance
        if near_prime_time and slows_down and all(on_target[t : t + hold + 1]):
            return 1.0
    return 0.0


def _foot_skating(joints, fps, constants) -> float:
    steps = range(len(joints) - 1)
    half = round(constants.foot_window * fps) // 2
    speed = [[fps * np.hypot(*(joints[t + 1, toe] - joints[t, toe])[[0, 2]]) for t in steps] for toe in TOES]
    skating = 0
    for t in steps:
        for toe, own in zip(TOES, speed):
            low = joints[t, toe, 1] < constants.foot_height and joints[t + 1, toe, 1] < constants.foot_height
            average = sum(own[max(t - half, 0) : t + half + 1]) / (2 * half + 1)
            if low and own[t] > constants.foot_speed and average > constants.foot_speed:
                skating += 1
                break
    return skating / len(steps)
