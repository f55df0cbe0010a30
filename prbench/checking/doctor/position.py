"""Motions that do not begin over the origin."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding
from prbench.skeleton import Joint

_CERTAIN, _SUSPICIOUS = 0.25, 0.10  # metres
_GROUND = [0, 2]


def examine_position(motion_set: MotionSet) -> Finding:
    """Compare where the pelvis begins with the initial pose, or with the origin."""
    if motion_set.pinned:
        return no_finding(motion_set)
    off = motion_set.first_poses()[:, Joint.PELVIS][:, _GROUND] - _wanted(motion_set)
    distance = np.linalg.norm(off, axis=1)
    typical = float(np.median(distance))
    if typical < _SUSPICIOUS:
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
    certain = typical > _CERTAIN and not motion_set.motionless
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
