"""Bodies that float over the floor or sink into it, always alike or more and more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import Diagnosis
from prbench.skeleton import Joint

_CERTAIN, _SUSPICIOUS = 0.08, 0.04  # metres
_STRONG_DRIFT, _DRIFT, _SLIGHT_DRIFT = 0.30, 0.12, 0.07  # metres over a motion
_STRAIGHT = 0.7  # share of the change that a straight line explains
_SHORTEST = 1.0  # seconds
_ENOUGH = 3  # motions that drift alike; a single person may climb a step
_UP = np.array([0.0, 1.0, 0.0])


def examine_floor(patient: Patient) -> Finding:
    """Look at the lowest joint: 0 in the canonical frame, and never far from it where feet stand."""
    if patient.pinned:
        return healthy(patient)
    drift = _examine_drift(patient)
    constant = _examine_height(drift.patient)
    return Finding((*drift.diagnoses, *constant.diagnoses), constant.patient)


def _examine_height(patient: Patient) -> Finding:
    lowest = np.array([motion[..., 1].min() for motion in patient.motions])
    typical = float(np.median(lowest))
    if abs(typical) < _SUSPICIOUS:
        return healthy(patient)
    pelvis = float(np.median(patient.first_poses()[:, Joint.PELVIS, 1]))
    evidence = f"the lowest joint of a motion lies at Y = {typical:+.3f} m (median of {len(patient)}), not at 0"
    if abs(pelvis) < 0.03:
        cause = "heights are measured from the pelvis"
    else:
        cause = f"the floor of another frame: bodies {'float over' if typical > 0 else 'sink into'} it"
    remedy = "Move each whole motion until its lowest joint is at Y = 0: prbench.representation.canonicalise."
    found = Diagnosis("floor", abs(typical) > _CERTAIN, evidence, cause, remedy)
    undone = [motion - low * _UP for motion, low in zip(patient.motions, lowest, strict=True)]
    return Finding((found,), patient.with_motions(undone))


@dataclass(frozen=True)
class _Drift:
    """How the height of the support changes in one motion."""

    rise: float
    """Metres from the first to the last frame."""
    straightness: float
    """Share of the variance that the line explains."""


def _examine_drift(patient: Patient) -> Finding:
    rows = [row for row, motion in enumerate(patient.motions) if len(motion) >= _SHORTEST * patient.fps]
    drifts = {row: _drift(patient.motions[row], patient.fps) for row in rows}
    strong = [row for row in rows if abs(drifts[row].rise) > _SLIGHT_DRIFT and drifts[row].straightness > _STRAIGHT]
    if not rows or len(strong) <= len(rows) / 2:
        return healthy(patient)
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
    undone = [_levelled(motion, drifts[row]) if row in strong else motion for row, motion in enumerate(patient.motions)]
    return Finding((found,), patient.with_motions(undone))


def _drift(motion: np.ndarray, fps: float) -> _Drift:
    reach = max(1, round(0.25 * fps))  # frames on each side: a swinging foot does not count
    lowest = np.pad(motion[..., 1].min(axis=1), reach, mode="edge")
    support = np.lib.stride_tricks.sliding_window_view(lowest, 2 * reach + 1).min(axis=1)
    time = np.linspace(0.0, 1.0, len(motion))
    slope, _ = np.polyfit(time, support, 1)
    correlation = np.corrcoef(time, support)[0, 1] if np.ptp(support) > 1e-6 else 0.0
    return _Drift(float(slope), float(correlation**2))


def _levelled(motion: np.ndarray, drift: _Drift) -> np.ndarray:
    """The motion without its drift, on the floor."""
    level = motion - np.linspace(0.0, drift.rise, len(motion))[:, None, None] * _UP
    return level - level[..., 1].min() * _UP
