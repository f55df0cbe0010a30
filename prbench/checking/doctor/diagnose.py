"""Runs all examinations in their order, each on motions that are free of the faults found before it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prbench.checking.doctor.body import examine_body, examine_finite, examine_scale, examine_unit
from prbench.checking.doctor.clock import examine_clock
from prbench.checking.doctor.facing import examine_facing, examine_root
from prbench.checking.doctor.floor import examine_first_frame, examine_floor, examine_position
from prbench.checking.doctor.frame_rate import examine_frame_rate, examine_length
from prbench.checking.doctor.joint_order import examine_joint_order
from prbench.checking.doctor.left_right import examine_left_right
from prbench.checking.doctor.motion_set import NOTHING_KNOWN, Diagnosis, Examination, Expected, Finding, MotionSet
from prbench.checking.doctor.quality import examine_quality
from prbench.checking.doctor.recorded_clock import examine_recorded_clock
from prbench.checking.doctor.shape import examine_shape
from prbench.checking.doctor.up_axis import examine_up_axis


def _examine_time(motion_set: MotionSet) -> Finding:
    """Return one diagnosis of time: uneven time also changes speeds, and a wrong rate also moves instants."""
    findings = []
    for examine in (examine_clock, examine_recorded_clock):  # a proof by the recording outweighs a suspicion
        findings.append(examine(motion_set))
        if any(diagnosis.certain for diagnosis in findings[-1].diagnoses):
            return findings[-1]
    suspicion = next((finding for finding in findings if finding.diagnoses), Finding((), motion_set))
    rest = examine_frame_rate(suspicion.motion_set)
    return Finding((*suspicion.diagnoses, *rest.diagnoses), rest.motion_set)


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
    _examine_time,
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
    motion_set = MotionSet(tuple(np.asarray(motion, dtype=np.float64) for motion in motions), known, fps)
    diagnoses: list[Diagnosis] = []
    # Each examination gets the motions with the earlier faults undone, or it would report them again.
    for examine in _EXAMINATIONS:
        finding = examine(motion_set)
        diagnoses += finding.diagnoses
        if finding.unreadable:
            break
        motion_set = finding.motion_set
    return tuple(diagnoses)
