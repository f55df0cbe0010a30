"""Whether the numbers are positions of a body at all: standardised joints and velocities are not."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.bones import Distances
from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import Diagnosis

_SHAPELESS = 3.0  # times the spread of a coordinate; a body's joints have mean heights much farther apart
_FLABBY = 0.12  # change of the distances that change least, as a share of themselves


def examine_body(patient: Patient) -> Finding:
    """Bodies have joints in different places on average, and bones that keep their lengths."""
    shape, softness = _shape(patient), _softness(patient)
    if shape >= _SHAPELESS or (softness < _FLABBY and shape > 1.0):
        return healthy(patient)
    evidence = (
        f"mean places of the joints lie {shape:.1f} standard deviations apart (those of bodies more than"
        f" {_SHAPELESS:g}); the steadiest distances between joints vary by {softness:.0%}"
    )
    return Finding((not_positions(patient, evidence) or _noise(evidence),), patient, hopeless=True)


def not_positions(patient: Patient, evidence: str) -> Diagnosis | None:
    """What else the numbers may be, from their size."""
    poses = patient.poses()
    middle, spread = float(np.median(np.abs(poses.mean(axis=0)))), float(poses.std())
    numbers = f"{evidence}; the numbers have a standard deviation of {spread:.2g}, means of {middle:.2g} (median)"
    if spread < 0.2:
        cause = "these look like steps from frame to frame (velocities), not like positions"
        return Diagnosis("standardised", True, numbers, cause, "Add them up over time, beginning with the first pose.")
    if spread < 5 and middle < 2:
        cause = "the mean was subtracted and the standard deviation divided out, and neither was put back"
        remedy = "Undo it with the statistics of the training: joints * std + mean."
        return Diagnosis("standardised", True, numbers, cause, remedy)
    return None


def _noise(evidence: str) -> Diagnosis:
    remedy = "Undo the scaling of the training before the motions are handed over."
    return Diagnosis("standardised", True, evidence, "scaled features, offsets or noise instead of positions", remedy)


def _shape(patient: Patient) -> float:
    """Distance between mean places of joints on the axis that separates them best, in standard deviations."""
    poses = patient.poses()
    if len(poses) < 2:
        return np.inf
    apart = np.ptp(poses.mean(axis=0), axis=0)
    varied = np.median(poses.std(axis=0), axis=0)
    return float((apart / np.maximum(varied, 1e-9)).max())


def _softness(patient: Patient) -> float:
    """Mean relative change of the distances that change least, as many as there are joints."""
    distances = Distances.of(patient.motions)
    upper = np.triu_indices(len(distances.median), 1)
    relative = distances.spread[upper] / np.maximum(distances.median[upper], 1e-9)
    return float(np.sort(relative)[: len(distances.median)].mean())
