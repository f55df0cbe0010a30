"""Checks of the predicted bodies: where they begin, and whether they keep their size."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prbench.checking.conformance.answer import metres
from prbench.checking.conformance.check import check
from prbench.checking.conformance.predictors.subject import PredictorSubject
from prbench.checking.conformance.report import Observation, failed, passed, warning
from prbench.prediction.metrics import bone_error, first_frame_jump

_JUMP_WARNING = 0.1
_JUMP_FAILURE = 1.0
"""Metres between the last observed and the first predicted frame, median over windows."""
_BONES_WARNING = 10.0
_BONES_FAILURE = 50.0
"""Per cent, median over windows."""


@check("first-frame", "futures go on where the observed frames end", of_motions=True)
def first_frame(subject: PredictorSubject) -> Iterator[Observation]:
    """Measure the jump from the last observed to the first predicted frame."""
    answer = subject.standard(subject.main)
    jump = float(np.median(first_frame_jump(answer.motions.joints, answer.batch.observed_joints[:, -1])))
    text = f"{metres(jump)} from the last observed to the first predicted frame (median)."
    if jump > _JUMP_FAILURE:
        yield failed(text, "Answer in metres, Y up, in the frame of the observed joints.", jump_m=jump)
    elif jump > _JUMP_WARNING:
        yield warning(
            text, "A body cannot move so far in a frame; the metrics show it as first-frame jump.", jump_m=jump
        )
    else:
        yield passed(text, jump_m=jump)


@check("bone-lengths", "one body, of one size", of_motions=True)
def bones(subject: PredictorSubject) -> Iterator[Observation]:
    """Compare bone lengths with those of the last observed pose."""
    answer = subject.standard(subject.main)
    joints = subject.cases.table.joints
    errors = bone_error(answer.motions.joints, answer.batch.observed_joints[:, -1], joints.bones)
    error = float(np.median(errors))
    text = f"bones differ from those of the last observed pose by {error:.1f} % (median)."
    remedy = "Look at the order of joints (batch.joint_names), at units, and at averages over turned poses."
    if error > _BONES_FAILURE:
        yield failed(text, remedy, bone_error_percent=error)
    elif error > _BONES_WARNING:
        yield warning(text, remedy, bone_error_percent=error)
    else:
        yield passed(text, bone_error_percent=error)


CHECKS = (first_frame, bones)
