"""Motions that are played too fast or too slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.remedies import AT_RATE
from prbench.checking.doctor.tempo import tempo_of_limbs
from prbench.checking.doctor.types import Diagnosis, Expected

_CONTINUES, _BEGINS_THERE = 0.8, 0.05  # cosine between velocities; metres between frame 0 and the initial pose
_SLOWEST = 0.05  # m/s of the joints' root mean square: slower starts are noise
_OFF = np.log(1.2)
_AGREEING = 0.25  # interquartile range of the logarithm of the ratio
_ENOUGH = 5


@dataclass(frozen=True)
class _Start:
    """How a motion goes on from the initial state."""

    ratio: float
    """First step over the step before it."""
    cosine: float


def examine_frame_rate(patient: Patient) -> Finding:
    """Compare first steps with initial velocities; without these, look at how long feet and hands take."""
    if patient.pinned:
        return healthy(patient)
    starts = [
        start
        for motion, expected in zip(patient.motions, patient.expected, strict=True)
        if (start := _start(motion, expected, patient.fps)) is not None
    ]
    going_on = [start.ratio for start in starts if start.cosine > _CONTINUES and start.ratio > 0]
    if len(going_on) * 2 > len(starts) and len(going_on) >= 3:
        return Finding(_by_velocity(np.log(going_on), patient), patient)
    return Finding(tempo_of_limbs(patient), patient)


def _start(motion: np.ndarray, expected: Expected, fps: float) -> _Start | None:
    initial, previous = expected.initial_joints, expected.previous_joints
    if initial is None or previous is None or len(motion) < 2:
        return None
    before, after = (initial - previous).ravel(), (motion[1] - motion[0]).ravel()
    speed = float(np.sqrt((before**2).sum() / len(initial))) * fps
    if speed < _SLOWEST or float(np.abs(motion[0] - initial).max()) > _BEGINS_THERE:
        return None
    length = max(float(np.linalg.norm(before) * np.linalg.norm(after)), 1e-12)
    return _Start(float(before @ after / (before @ before)), float(before @ after / length))


def _by_velocity(logs: np.ndarray, patient: Patient) -> tuple[Diagnosis, ...]:
    middle, spread = float(np.median(logs)), float(np.subtract(*np.percentile(logs, [75, 25])))
    if abs(middle) < _OFF or spread > _AGREEING:
        return ()
    ratio = float(np.exp(middle))
    evidence = (
        f"the step from frame 0 to 1 goes on in the direction of the initial velocity and is {ratio:.2f} times as long"
        f" (median of {len(logs)} starts in movement, middle half within {np.exp(spread / 2):.2f} times)"
    )
    fast = "fast" if ratio > 1 else "slowly"
    made = f"{patient.fps / ratio:.3g} frames a second shown at {patient.fps:g}"
    cause = f"motions are played too {fast}: they look like {made}"
    return (Diagnosis("frame-rate", len(logs) >= _ENOUGH, evidence, cause, AT_RATE),)
