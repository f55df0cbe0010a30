"""All examinations in their order, each on motions that are free of the faults before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prbench.checking.doctor.body import examine_body
from prbench.checking.doctor.facing import examine_facing
from prbench.checking.doctor.finite import examine_finite
from prbench.checking.doctor.first_frame import examine_first_frame
from prbench.checking.doctor.floor import examine_floor
from prbench.checking.doctor.joint_order import examine_joint_order
from prbench.checking.doctor.left_right import examine_left_right
from prbench.checking.doctor.length import examine_length
from prbench.checking.doctor.patient import Examination, Patient
from prbench.checking.doctor.position import examine_position
from prbench.checking.doctor.quality import examine_quality
from prbench.checking.doctor.root import examine_root
from prbench.checking.doctor.shape import examine_shape
from prbench.checking.doctor.time import examine_time
from prbench.checking.doctor.types import NOTHING_KNOWN, Diagnosis, Expected
from prbench.checking.doctor.unit import examine_scale, examine_unit
from prbench.checking.doctor.up_axis import examine_up_axis

_EXAMINATIONS: tuple[Examination, ...] = (
    examine_shape,
    examine_finite,
    examine_body,
    examine_unit,
    examine_joint_order,
    examine_scale,
    examine_up_axis,
    examine_left_right,
    examine_root,
    examine_first_frame,
    examine_facing,
    examine_position,
    examine_floor,
    examine_length,
    examine_time,
    examine_quality,
)
"""In the order in which faults hide one another."""


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
