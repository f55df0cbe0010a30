"""Millimetres, centimetres, inches or feet instead of metres."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import Diagnosis
from prbench.methods.body_size import wrong_unit
from prbench.skeleton import N_JOINTS, bone_lengths

_SCALED = 0.10  # deviation from the scale of the initial pose's bones


def examine_unit(patient: Patient) -> Finding:
    """Compare the size of bodies with that of people, whatever the axes and the order of joints are."""
    found = wrong_unit(patient.poses())
    if found is None:
        return healthy(patient)
    diagnosis = Diagnosis("unit", True, found.evidence, found.cause, found.remedy)
    return Finding((diagnosis,), patient.changed(lambda motion: motion * found.metres_per_unit))


def examine_scale(patient: Patient) -> Finding:
    """Compare bones with those of the initial poses, where these are known; the order of joints has been found."""
    known = [row for row in range(len(patient)) if patient.expected[row].initial_joints is not None]
    if not known or patient.motions[0].shape[1] != N_JOINTS:
        return healthy(patient)
    ratios = np.array([_size_ratio(patient.motions[row], patient.expected[row].initial_joints) for row in known])
    ratio, agreeing = float(np.median(ratios)), float(np.ptp(np.percentile(ratios, [10, 90])))
    if abs(ratio - 1) < _SCALED or agreeing > _SCALED / 2:
        return healthy(patient)
    evidence = f"bones are {ratio:.3f} times as long as those of the initial poses (10 to 90 %: ± {agreeing / 2:.3f})"
    cause = "positions were divided by a body height or put on a skeleton of another size"
    remedy = f"Divide the joints by {ratio:.3f}, or put them back on the initial pose's bones."
    found = Diagnosis("unit", True, evidence, cause, remedy)
    return Finding((found,), patient.changed(lambda motion: motion / ratio))


def _size_ratio(motion: np.ndarray, pose: np.ndarray | None) -> float:
    assert pose is not None
    return float(bone_lengths(motion[:: max(1, len(motion) // 16)]).sum(axis=-1).mean() / bone_lengths(pose).sum())
