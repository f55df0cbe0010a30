"""Millimetres, centimetres, inches or feet instead of metres."""

from __future__ import annotations

import numpy as np

from prbench.evaluation.doctor.anatomy import body_size
from prbench.evaluation.doctor.patient import Finding, Patient, healthy
from prbench.evaluation.doctor.types import Diagnosis
from prbench.skeleton import N_JOINTS, bone_lengths

_SMALLEST, _TYPICAL, _LARGEST = 0.65, 1.5, 2.35  # metres between the two joints of a pose that lie farthest apart
_UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254), ("decimetres", 0.1), ("feet", 0.3048))
_SCALED = 0.10  # deviation from the scale of the initial pose's bones


def examine_unit(patient: Patient) -> Finding:
    """Compare the size of bodies with that of people, whatever the axes and the order of joints are."""
    size = body_size(patient.poses())
    if size < 1e-9 or _SMALLEST <= size <= _LARGEST:
        return healthy(patient)
    evidence = f"the joints of a pose lie up to {size:.4g} apart (median); those of people 0.65 to 2.35 m"
    fits = [unit for unit in _UNITS if _SMALLEST <= size * unit[1] <= _LARGEST]
    if fits:
        name, factor = min(fits, key=lambda unit: abs(np.log(size * unit[1] / _TYPICAL)))
        cause, remedy = f"positions are in {name}", f"Multiply the joints by {factor:g}: prbench wants metres."
    else:
        factor = _TYPICAL / size
        cause = "positions were divided by a height or a standard deviation, or are in a unit of their own"
        remedy = f"Undo the scaling before the motions are handed over; a factor near {factor:.3g} gives people's size."
    return Finding((Diagnosis("unit", True, evidence, cause, remedy),), patient.changed(lambda motion: motion * factor))


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
