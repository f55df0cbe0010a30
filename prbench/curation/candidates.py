"""Proposals for pick events that nobody has annotated yet: when which wrist probably reached something.

A proposal is for a person to confirm at the video, never an event. It looks for what reaching looks like: a wrist that
comes to rest (a minimum of its speed) with the arm stretched out and gaze on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import nearest_index
from prbench.recording import BodyStream, Recording
from prbench.recording.streams import Side

_SIDES: tuple[Side, Side] = ("left", "right")
_ARMS = (
    (Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST),
    (Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST),
)
_SMOOTHING = 0.17  # seconds
_BEFORE = 1.0  # seconds before a minimum in which the wrist must have moved and gaze is looked at
_STARTED = 0.35  # m/s relative to the pelvis; slower wrists did not reach
_BENT = 0.55  # share of the arm's length
_STRETCHED = 0.95
_ON_WRIST = 0.10  # metres between ray and wrist
_FAR_FROM_WRIST = 0.45
_NEAR_HINT = 0.5  # seconds
_WEIGHTS = {"arm": 0.35, "gaze": 0.35, "stop": 0.20, "moved": 0.10}
_HINT_SHARE = 0.5
"""Share of the remaining doubt that a hint takes away."""


@dataclass(frozen=True)
class Candidate:
    """One proposed pick."""

    time: float
    """Seconds on the recording's clock."""
    hand: Side
    confidence: float
    """A number from 0 to 1 that ranks proposals; it is no probability."""
    reason: str
    """Hints that speak for it, for the person who decides."""


def propose_pick(recording: Recording, *, hint: float | None = None) -> Candidate | None:
    """The most probable pick of a recording that should hold one.

    Args:
        recording: With a body.
        hint: Time at which the dataset hints at a contact, seconds; the proposal stays within half a second of it.

    Returns:
        None if there is no body, or no wrist ever slows down after moving and there is no hint.
    """
    body = recording.body
    if body is None or int(body.valid.sum()) < 3:
        return None
    times = body.times[body.valid]
    joints = body.joints[body.valid]
    moved = [float(_relative_speed(times, joints, arm[2]).sum()) for arm in _ARMS]
    found = [
        _judged(recording, times, joints, side, int(row), moved[side] >= max(moved))
        for side in (0, 1)
        for row in _stops(times, joints, side)
        if hint is None or abs(times[row] - hint) <= _NEAR_HINT
    ]
    if hint is not None:
        return _with_hint(recording, body, hint, found, moved)
    return max(found, key=lambda candidate: candidate.confidence, default=None)


def _with_hint(
    recording: Recording, body: BodyStream, hint: float, found: list[Candidate], moved: list[float]
) -> Candidate:
    """The best stop near the hint, else the hint itself with the wrist that moved more."""
    best = max(found, key=lambda candidate: candidate.confidence, default=None)
    if best is None:
        side = int(np.argmax(moved))
        row = int(nearest_index(body.times[body.valid], np.array([hint]))[0])
        best = _judged(recording, body.times[body.valid], body.joints[body.valid], side, row, True)
    confidence = 1 - (1 - best.confidence) * (1 - _HINT_SHARE)
    apart = best.time - hint
    return Candidate(best.time, best.hand, round(confidence, 2), f"hint {apart:+.2f} s away; {best.reason}")


def _stops(times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"], side: int) -> Int[np.ndarray, " k"]:
    """Frames at which a wrist, moved before, is slower than around them."""
    speed = _relative_speed(times, joints, _ARMS[side][2])
    inner = np.flatnonzero((speed[1:-1] <= speed[:-2]) & (speed[1:-1] < speed[2:])) + 1
    first = np.searchsorted(times, times[inner] - _BEFORE)
    fast = np.array([speed[start : row + 1].max() for start, row in zip(first, inner, strict=True)])
    return inner[fast >= _STARTED] if len(inner) else inner


def _relative_speed(
    times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"], wrist: int
) -> Float[np.ndarray, " n"]:
    """Speed of a wrist seen from the pelvis, m/s, smoothed."""
    relative = joints[:, wrist] - joints[:, Joint.PELVIS]
    speed = np.linalg.norm(np.gradient(relative, times, axis=0), axis=1)
    # An odd width keeps the smoothed speed centred on its frame.
    width = max(round(_SMOOTHING / float(np.median(np.diff(times)))), 1) | 1
    padded = np.pad(speed, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1 / width), mode="valid")


def _judged(
    recording: Recording,
    times: Float[np.ndarray, " n"],
    joints: Float[np.ndarray, "n 22 3"],
    side: int,
    row: int,
    moved_more: bool,
) -> Candidate:
    """Judge how much one stop looks like reaching."""
    shoulder, elbow, wrist = _ARMS[side]
    speed = _relative_speed(times, joints, wrist)
    start = int(np.searchsorted(times, times[row] - _BEFORE))
    arm = np.linalg.norm(joints[row, elbow] - joints[row, shoulder]) + np.linalg.norm(
        joints[row, wrist] - joints[row, elbow]
    )
    stretch = float(np.linalg.norm(joints[row, wrist] - joints[row, shoulder]) / arm)
    look = _nearest_look(recording, joints[row, wrist], times[start], times[row])
    fastest = float(speed[start : row + 1].max())
    marks = {
        "arm": _share(stretch, _BENT, _STRETCHED) * _lifted(joints[row], wrist),
        "gaze": _share(look, _FAR_FROM_WRIST, _ON_WRIST),
        "stop": 1 - min(float(speed[row]) / max(fastest, _STARTED), 1.0),
        "moved": float(moved_more),
    }
    confidence = sum(weight * marks[name] for name, weight in _WEIGHTS.items())
    seen = "no gaze" if np.isinf(look) else f"gaze {look * 100:.0f} cm from the wrist"
    reason = (
        f"{_SIDES[side]} wrist slows from {fastest:.1f} to {speed[row]:.1f} m/s; arm {stretch:.0%} stretched; {seen}"
        + ("; this wrist moves more" if moved_more else "")
    )
    return Candidate(float(times[row]), _SIDES[side], round(confidence, 2), reason)


def _lifted(joints: Float[np.ndarray, "22 3"], wrist: int) -> float:
    """0 for an arm that hangs beside the pelvis, 1 for a wrist 30 cm away from its axis or above the chest."""
    aside = float(np.hypot(*(joints[wrist] - joints[Joint.PELVIS])[[0, 2]]))
    above = float(joints[wrist, 1] - joints[Joint.SPINE3, 1])
    return max(_share(aside, 0.25, 0.40), _share(above, 0.0, 0.1))


def _nearest_look(recording: Recording, point: Float[np.ndarray, "3"], start: float, end: float) -> float:
    """Return the distance of the nearest gaze to a point between two times, metres; infinite without gaze."""
    gaze = recording.gaze
    rows = np.flatnonzero(gaze.valid & (gaze.times >= start) & (gaze.times <= end))
    if len(rows) == 0:
        return float("inf")
    apart = point - gaze.origin[rows]
    along = np.maximum((apart * gaze.direction[rows]).sum(axis=1), 0.0)
    return float(np.linalg.norm(apart - along[:, None] * gaze.direction[rows], axis=1).min())


def _share(value: float, none: float, all_: float) -> float:
    """0 at ``none``, 1 at ``all_``, linear between."""
    return float(np.clip((value - none) / (all_ - none), 0.0, 1.0))
