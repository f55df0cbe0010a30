"""Motions that do not begin over the origin."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import Diagnosis
from prbench.skeleton import Joint

_CERTAIN, _SUSPICIOUS = 0.25, 0.10  # metres
_GROUND = [0, 2]


def examine_position(patient: Patient) -> Finding:
    """Compare where the pelvis begins with the initial pose, or with the origin."""
    if patient.pinned:
        return healthy(patient)
    off = patient.first_poses()[:, Joint.PELVIS][:, _GROUND] - _wanted(patient)
    distance = np.linalg.norm(off, axis=1)
    typical = float(np.median(distance))
    if typical < _SUSPICIOUS:
        return healthy(patient)
    middle = np.median(off, axis=0)
    common = float(np.median(np.linalg.norm(off - middle, axis=1))) < 0.2 * typical
    evidence = f"the pelvis begins {typical:.2f} m off the point over the origin (median of {len(patient)})"
    if common and len(patient) > 1:
        evidence += f", always near x = {middle[0]:+.2f}, z = {middle[1]:+.2f}"
    cause = "motions are still where they were in their room" + (
        ", all with the same shift" if common and len(patient) > 1 else ""
    )
    remedy = "Move each whole motion until its first pelvis stands over x = z = 0: prbench.representation.canonicalise."
    certain = typical > _CERTAIN and not patient.motionless
    shifts = [np.array([x, 0.0, z]) for x, z in off]
    undone = [motion - shift for motion, shift in zip(patient.motions, shifts, strict=True)]
    return Finding((Diagnosis("position", certain, evidence, cause, remedy),), patient.with_motions(undone))


def _wanted(patient: Patient) -> np.ndarray:
    return np.array(
        [
            np.zeros(2) if known.initial_joints is None else known.initial_joints[Joint.PELVIS][_GROUND]
            for known in patient.expected
        ]
    )
