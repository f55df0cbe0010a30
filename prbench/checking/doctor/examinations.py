"""Looks for one fault after another in motions, each with the earlier ones undone."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from prbench.checking.doctor import body, frame_rate, place
from prbench.checking.doctor.joint_order import examine_joint_order, examine_left_right
from prbench.checking.doctor.motion_set import NOTHING_KNOWN, Diagnosis, Expected, Finding, MotionSet

Examination = Callable[[MotionSet], Finding | None]
# Examinations, in the order in which faults hide one another
_OF_NUMBERS = (body.examine_empty, body.examine_shape, body.examine_finite, body.examine_body, body.examine_unit)
_OF_JOINTS = (examine_joint_order, body.examine_scale, place.examine_up_axis, examine_left_right)
_OF_WAYS = (place.examine_root, place.examine_first_frame, place.examine_facing, place.examine_position)
_OF_CLOCKS = (frame_rate.examine_repeats, frame_rate.examine_holds, frame_rate.examine_rhythm)
_OF_TIME = (frame_rate.examine_length, *_OF_CLOCKS, frame_rate.examine_frame_rate)
EXAMINATIONS: tuple[Examination, ...] = (*_OF_NUMBERS, *_OF_JOINTS, *_OF_WAYS, place.examine_floor, *_OF_TIME)
OF_A_BODY = (*_OF_NUMBERS, *_OF_JOINTS)
# A floor that is missed, and a clock that stumbles, may be how a method moves; the other faults are those of files.
_OF_A_METHOD = (place.examine_floor, *_OF_CLOCKS)
OF_THE_CONVERSION = tuple(each for each in EXAMINATIONS if each not in _OF_A_METHOD)


def diagnose(
    motions: Sequence[np.ndarray],
    expected: Sequence[Expected] | None,
    *,
    fps: float,
    examinations: Sequence[Examination] = EXAMINATIONS,
) -> tuple[Diagnosis, ...]:
    """Say from the numbers what is wrong with motions.

    Args:
        motions: Normally each (frames, 22, 3), canonical frame, metres; any other shape is diagnosed, too.
        expected: What is known beside each motion; None = nothing.
        fps: Frames a second that the motions are said to have.
        examinations: What is looked for, in this order; everything by default.

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
    arrays = [np.atleast_1d(np.asarray(motion, dtype=np.float64)) for motion in motions]
    # The square of a larger number overflows, and no measure of bodies would mean anything.
    arrays = [np.where(np.abs(motion) > body.LARGEST_NUMBER, np.inf, motion) for motion in arrays]
    motion_set = MotionSet(tuple(arrays), known, fps)
    diagnoses: list[Diagnosis] = []
    # Each examination gets the motions with the earlier faults undone, or it would report them again.
    for examine in examinations:
        if any(each.kind == "clock" and each.certain for each in diagnoses):
            break  # uneven time also changes speeds, by which the rest would judge
        with np.errstate(all="ignore"):  # bodies that are one point have no directions; such NaN decides nothing
            finding = examine(motion_set)
        if finding is not None:
            diagnoses += finding.diagnoses
            if finding.unreadable:
                break
            motion_set = finding.motion_set
    return tuple(diagnoses)
