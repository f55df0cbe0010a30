"""Finds motions in the wrong place: off the floor, off the origin, or torn from their first frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.facing import headings, turned, wrapped
from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding
from prbench.geometry.skeleton import Joint

_CERTAIN = 0.08  # metres over or under the floor
_SUSPICIOUS = 0.04  # metres
_STRONG_DRIFT = 0.30  # metres over a motion, for which few motions suffice
_DRIFT = 0.12  # metres over a motion that are certain in several motions
_SLIGHT_DRIFT = 0.07  # metres over a motion that count at all
_STRAIGHT = 0.7  # share of the change that a straight line explains
_SHORTEST = 1.0  # seconds
_ENOUGH = 3  # motions that drift alike; a single person may climb a step
_UP = np.array([0.0, 1.0, 0.0])
_FAR = 0.25  # metres between the first pelvis and its place on the ground: certain
_NEAR = 0.10  # metres: not even suspicious
_GROUND = [0, 2]
_TURN = np.deg2rad(25.0)  # radians from one frame to the next
_STEP = 6.0  # metres a second
_TIMES = 4.0  # what comes after it


@dataclass(frozen=True)
class _Drift:
    """Change of the lowest height in one motion."""

    rise: float
    """Metres from the first to the last frame."""
    straightness: float
    """Share of the variance that the line explains."""


def examine_floor(motion_set: MotionSet) -> Finding:
    """Look at the lowest joint: 0 in the canonical frame, and never far from it where feet stand."""
    if motion_set.pinned:
        return no_finding(motion_set)
    drift = _examine_drift(motion_set)
    constant = _examine_height(drift.motion_set)
    return Finding((*drift.diagnoses, *constant.diagnoses), constant.motion_set)


def _examine_height(motion_set: MotionSet) -> Finding:
    lowest = np.array([motion[..., 1].min() for motion in motion_set.motions])
    typical = float(np.median(lowest))
    if abs(typical) < _SUSPICIOUS:
        return no_finding(motion_set)
    pelvis = float(np.median(motion_set.first_poses()[:, Joint.PELVIS, 1]))
    evidence = f"the lowest joint of a motion lies at Y = {typical:+.3f} m (median of {len(motion_set)}), not at 0"
    if abs(pelvis) < 0.03:
        cause = "heights are measured from the pelvis"
    else:
        cause = f"the floor of another frame: bodies {'float over' if typical > 0 else 'sink into'} it"
    remedy = "Move each whole motion until its lowest joint is at Y = 0: prbench.representation.canonicalise."
    found = Diagnosis("floor", abs(typical) > _CERTAIN, evidence, cause, remedy)
    undone = [motion - low * _UP for motion, low in zip(motion_set.motions, lowest, strict=True)]
    return Finding((found,), motion_set.with_motions(undone))


def _examine_drift(motion_set: MotionSet) -> Finding:
    rows = [row for row, motion in enumerate(motion_set.motions) if len(motion) >= _SHORTEST * motion_set.fps]
    drifts = {row: _drift(motion_set.motions[row], motion_set.fps) for row in rows}
    strong = [row for row in rows if abs(drifts[row].rise) > _SLIGHT_DRIFT and drifts[row].straightness > _STRAIGHT]
    if not rows or len(strong) <= len(rows) / 2:
        return no_finding(motion_set)
    rises = np.array([drifts[row].rise for row in strong])
    typical = float(np.median(np.abs(rises)))
    evidence = (
        f"the lowest joint {'rises' if np.median(rises) > 0 else 'sinks'} by {typical:.2f} m from the first to the last"
        f" frame of {len(strong)} of {len(rows)} motions, along a straight line"
    )
    cause = "height is added up from velocities and drifts, or the ground of the source is tilted"
    remedy = "Take the height itself instead of adding up its changes (column 3 of the 263 features is the height)."
    certain = typical > (_DRIFT if len(strong) >= _ENOUGH else _STRONG_DRIFT)
    found = Diagnosis("floor", certain, evidence, cause, remedy)
    undone = [
        _levelled(motion, drifts[row]) if row in strong else motion for row, motion in enumerate(motion_set.motions)
    ]
    return Finding((found,), motion_set.with_motions(undone))


def _drift(motion: np.ndarray, fps: float) -> _Drift:
    reach = max(1, round(0.25 * fps))  # frames on each side: a swinging foot does not count
    lowest = np.pad(motion[..., 1].min(axis=1), reach, mode="edge")
    # The lowest height within half a second: one foot or the other stands in it.
    support = np.lib.stride_tricks.sliding_window_view(lowest, 2 * reach + 1).min(axis=1)
    time = np.linspace(0.0, 1.0, len(motion))
    slope, _ = np.polyfit(time, support, 1)
    correlation = np.corrcoef(time, support)[0, 1] if np.ptp(support) > 1e-6 else 0.0
    return _Drift(float(slope), float(correlation**2))


def _levelled(motion: np.ndarray, drift: _Drift) -> np.ndarray:
    """Remove the drift and put the motion on the floor."""
    level = motion - np.linspace(0.0, drift.rise, len(motion))[:, None, None] * _UP
    return level - level[..., 1].min() * _UP


def examine_position(motion_set: MotionSet) -> Finding:
    """Compare where the pelvis begins with the initial pose, or with the origin."""
    if motion_set.pinned:
        return no_finding(motion_set)
    off = motion_set.first_poses()[:, Joint.PELVIS][:, _GROUND] - _wanted(motion_set)
    distance = np.linalg.norm(off, axis=1)
    typical = float(np.median(distance))
    if typical < _NEAR:
        return no_finding(motion_set)
    middle = np.median(off, axis=0)
    common = float(np.median(np.linalg.norm(off - middle, axis=1))) < 0.2 * typical
    evidence = f"the pelvis begins {typical:.2f} m off the point over the origin (median of {len(motion_set)})"
    if common and len(motion_set) > 1:
        evidence += f", always near x = {middle[0]:+.2f}, z = {middle[1]:+.2f}"
    cause = "motions are still where they were in their room" + (
        ", all with the same shift" if common and len(motion_set) > 1 else ""
    )
    remedy = "Move each whole motion until its first pelvis stands over x = z = 0: prbench.representation.canonicalise."
    certain = typical > _FAR and not motion_set.motionless
    shifts = [np.array([x, 0.0, z]) for x, z in off]
    undone = [motion - shift for motion, shift in zip(motion_set.motions, shifts, strict=True)]
    return Finding((Diagnosis("position", certain, evidence, cause, remedy),), motion_set.with_motions(undone))


def _wanted(motion_set: MotionSet) -> np.ndarray:
    return np.array(
        [
            np.zeros(2) if known.initial_joints is None else known.initial_joints[Joint.PELVIS][_GROUND]
            for known in motion_set.expected
        ]
    )


def examine_first_frame(motion_set: MotionSet) -> Finding:
    """Look for a turn or a leap of the whole body between frames 0 and 1 that does not go on."""
    long = [row for row, motion in enumerate(motion_set.motions) if len(motion) > 3]
    if not long:
        return no_finding(motion_set)
    turns = np.array([wrapped(np.diff(headings(motion_set.motions[row][:3]))) for row in long])
    pelvis = [motion_set.motions[row][:3, Joint.PELVIS] for row in long]
    steps = np.array([np.linalg.norm(np.diff(path, axis=0), axis=1) for path in pelvis]) * motion_set.fps
    # A fast turn goes on in the next frame; a torn first frame does not.
    turning = (np.abs(turns[:, 0]) > _TURN) & (np.abs(turns[:, 0]) > _TIMES * np.abs(turns[:, 1]))
    leaping = (steps[:, 0] > _STEP) & (steps[:, 0] > _TIMES * steps[:, 1])
    broken = turning | leaping
    if broken.mean() <= 0.5:
        return no_finding(motion_set)
    kind = "facing" if turning.mean() >= leaping.mean() / 2 else "position"
    metres = np.median(steps[broken, 0]) / motion_set.fps
    degrees = np.rad2deg(np.median(np.abs(turns[broken, 0])))
    evidence = (
        f"from frame 0 to frame 1 the body of {motion_set.in_words(int(broken.sum()))} turns by {degrees:.0f} degrees"
        f" and leaps by {metres:.2f} m (medians), and not in the frame after"
    )
    cause = "only the first frame is canonical: the initial pose was put before motions that live in another frame"
    remedy = "Give all frames the transform of the first (prbench.representation.canonicalise moves whole motions)."
    found = Diagnosis(kind, True, evidence, cause, remedy)
    joined = {row: _joined(motion_set.motions[row]) for row, is_broken in zip(long, broken, strict=True) if is_broken}
    return Finding(
        (found,), motion_set.with_motions([joined.get(row, motion) for row, motion in enumerate(motion_set.motions)])
    )


def _joined(motion: np.ndarray) -> np.ndarray:
    """Move the frames after the first rigidly, so that they go on from it."""
    turns = wrapped(np.diff(headings(motion[:3])))
    rest = turned(motion[1:], float(turns[1] - turns[0]))
    path = rest[:, Joint.PELVIS]
    rest += motion[0, Joint.PELVIS] + (path[1] - path[0]) - path[0]
    return np.concatenate([motion[:1], rest])
