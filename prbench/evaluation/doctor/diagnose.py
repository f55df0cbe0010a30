"""All examinations in their order, each on motions that are free of the faults before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prbench.evaluation.doctor.patient import Examination, Patient
from prbench.evaluation.doctor.types import NOTHING_KNOWN, Diagnosis, Expected
from prbench.evaluation.doctor.unit import examine_unit

_EXAMINATIONS: tuple[Examination, ...] = (examine_unit,)


def diagnose(
    motions: Sequence[np.ndarray], expected: Sequence[Expected] | None, *, fps: float
) -> tuple[Diagnosis, ...]:
    """Say from the numbers what is wrong with motions.

    Args:
        motions: Normally each (frames, 22, 3), canonical frame, metres; any other shape is diagnosed, too.
        expected: What is known beside each motion; None = nothing.
        fps: Frames a second that the motions are said to have.

    Returns:
        Diagnoses in the order in which faults have to be repaired; empty if nothing was found. A fault that explains
        others comes alone: what is looked at later is looked at with that fault undone.

    Raises:
        ValueError: if ``expected`` has another length than ``motions``.
    """
    if expected is not None and len(expected) != len(motions):
        raise ValueError(f"{len(motions)} motions, but expectations of {len(expected)}")
    if not motions:
        return ()
    known = tuple(expected) if expected is not None else (NOTHING_KNOWN,) * len(motions)
    patient = Patient(tuple(np.asarray(motion, dtype=np.float64) for motion in motions), known, fps)
    diagnoses: list[Diagnosis] = []
    for examine in _EXAMINATIONS:
        finding = examine(patient)
        diagnoses += finding.diagnoses
        if finding.hopeless:
            break
        patient = finding.patient
    return tuple(diagnoses)
