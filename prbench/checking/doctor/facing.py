"""First frames that face another way than +Z."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.headings import headings, turned, wrapped
from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding

_CERTAIN, _SUSPICIOUS = np.deg2rad(25.0), np.deg2rad(15.0)
_AGREEING = 0.9  # length of the mean of unit vectors


def examine_facing(motion_set: MotionSet) -> Finding:
    """Compare the headings of first frames with those of the initial poses, or with +Z."""
    off = wrapped(headings(motion_set.first_poses()) - _wanted(motion_set))
    typical = float(np.median(np.abs(off)))
    if typical < _SUSPICIOUS:
        return no_finding(motion_set)
    mean = np.exp(1j * off).mean()
    common = abs(mean) > _AGREEING
    certain = bool(typical > _CERTAIN) and not motion_set.motionless
    degrees = np.rad2deg(np.angle(mean)) if common else np.rad2deg(typical)
    if common:
        evidence = f"in their first frame bodies face {degrees:+.0f} degrees off +Z (positive towards +X)"
        cause = "motions are turned as a whole, by the axes of another program or a canonical frame of its own"
        undone = motion_set.changed(lambda motion: turned(motion, -float(np.angle(mean))))
    else:
        lowest, highest = np.rad2deg(off.min()), np.rad2deg(off.max())
        evidence = (
            f"first frames face all ways: {degrees:.0f} degrees off +Z (median), from {lowest:.0f} to {highest:.0f}"
        )
        cause = "motions are in the frame of their rooms or recordings, and were not put into their canonical frames"
        undone = motion_set.with_motions(
            [turned(motion, -float(angle)) for motion, angle in zip(motion_set.motions, off, strict=True)]
        )
    if len(motion_set) > 1:
        evidence += f" ({len(motion_set)} motions)"
    remedy = "Turn each whole motion until its first frame faces +Z: prbench.representation.canonicalise."
    return Finding((Diagnosis("facing", certain, evidence, cause, remedy),), undone)


def _wanted(motion_set: MotionSet) -> np.ndarray:
    return np.array(
        [
            0.0 if known.initial_joints is None else float(headings(known.initial_joints))
            for known in motion_set.expected
        ]
    )
