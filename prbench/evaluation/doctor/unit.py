"""Millimetres, centimetres, inches or feet instead of metres."""

from __future__ import annotations

import numpy as np

from prbench.evaluation.doctor.patient import Finding, Patient, healthy
from prbench.evaluation.doctor.types import Diagnosis

_SMALLEST, _TYPICAL, _LARGEST = 0.65, 1.5, 2.35  # metres between the two joints of a pose that lie farthest apart
_UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254), ("decimetres", 0.1), ("feet", 0.3048))


def examine_unit(patient: Patient) -> Finding:
    """Compare the size of bodies with that of people, whatever the axes and the order of joints are."""
    size = body_size(patient.motions)
    if _SMALLEST <= size <= _LARGEST or size < 1e-9:
        return healthy(patient)
    fits = [unit for unit in _UNITS if _SMALLEST <= size * unit[1] <= _LARGEST]
    evidence = f"the joints of a pose lie up to {size:.4g} apart (median); those of people 0.65 to 2.35 m"
    if not fits:
        factor = _TYPICAL / size
        cause = "positions were divided by a height or a standard deviation, or are in a unit of their own"
        remedy = f"Undo the scaling before the motions are handed over; a factor near {factor:.3g} gives people's size."
    else:
        name, factor = min(fits, key=lambda unit: abs(np.log(size * unit[1] / _TYPICAL)))
        cause, remedy = f"positions are in {name}", f"Multiply the joints by {factor:g}: prbench wants metres."
    return Finding((Diagnosis("unit", True, evidence, cause, remedy),), patient.moved(lambda motion: motion * factor))


def body_size(motions: tuple[np.ndarray, ...]) -> float:
    """Median over frames of the largest distance between two joints of a pose."""
    poses = np.concatenate([motion[:: max(1, len(motion) // 32)] for motion in motions])
    poses = poses[np.isfinite(poses).all(axis=(1, 2))]
    if not len(poses):
        return 0.0
    apart = np.linalg.norm(poses[:, :, None] - poses[:, None], axis=-1)
    return float(np.median(apart.max(axis=(1, 2))))
