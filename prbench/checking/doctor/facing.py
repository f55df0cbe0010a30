"""First frames that face another way than +Z."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.headings import headings, turned, wrapped
from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import Diagnosis

_CERTAIN, _SUSPICIOUS = np.deg2rad(25.0), np.deg2rad(15.0)
_AGREEING = 0.9  # length of the mean of unit vectors


def examine_facing(patient: Patient) -> Finding:
    """Compare the headings of first frames with those of the initial poses, or with +Z."""
    off = wrapped(headings(patient.first_poses()) - _wanted(patient))
    typical = float(np.median(np.abs(off)))
    if typical < _SUSPICIOUS:
        return healthy(patient)
    mean = np.exp(1j * off).mean()
    common = abs(mean) > _AGREEING
    certain = bool(typical > _CERTAIN) and not patient.motionless
    degrees = np.rad2deg(np.angle(mean)) if common else np.rad2deg(typical)
    if common:
        evidence = f"in their first frame bodies face {degrees:+.0f} degrees off +Z (positive towards +X)"
        cause = "motions are turned as a whole, by the axes of another program or a canonical frame of its own"
        undone = patient.changed(lambda motion: turned(motion, -float(np.angle(mean))))
    else:
        lowest, highest = np.rad2deg(off.min()), np.rad2deg(off.max())
        evidence = (
            f"first frames face all ways: {degrees:.0f} degrees off +Z (median), from {lowest:.0f} to {highest:.0f}"
        )
        cause = "motions are in the frame of their rooms or recordings, and were not put into their canonical frames"
        undone = patient.with_motions(
            [turned(motion, -float(angle)) for motion, angle in zip(patient.motions, off, strict=True)]
        )
    if len(patient) > 1:
        evidence += f" ({len(patient)} motions)"
    remedy = "Turn each whole motion until its first frame faces +Z: prbench.representation.canonicalise."
    return Finding((Diagnosis("facing", certain, evidence, cause, remedy),), undone)


def _wanted(patient: Patient) -> np.ndarray:
    return np.array(
        [0.0 if known.initial_joints is None else float(headings(known.initial_joints)) for known in patient.expected]
    )
