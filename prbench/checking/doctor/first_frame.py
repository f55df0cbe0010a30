"""A first frame that does not belong to the rest: only it was put into the canonical frame."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.headings import headings, turned, wrapped
from prbench.checking.doctor.patient import Finding, Patient, healthy, of_motions
from prbench.checking.doctor.types import Diagnosis
from prbench.skeleton import Joint

_TURN, _STEP = np.deg2rad(25.0), 6.0  # radians from one frame to the next; metres a second
_TIMES = 4.0  # what comes after it


def examine_first_frame(patient: Patient) -> Finding:
    """Look for a turn or a leap of the whole body between frames 0 and 1 that does not go on."""
    long = [row for row, motion in enumerate(patient.motions) if len(motion) > 3]
    if not long:
        return healthy(patient)
    turns = np.array([wrapped(np.diff(headings(patient.motions[row][:3]))) for row in long])
    pelvis = [patient.motions[row][:3, Joint.PELVIS] for row in long]
    steps = np.array([np.linalg.norm(np.diff(path, axis=0), axis=1) for path in pelvis]) * patient.fps
    turning = (np.abs(turns[:, 0]) > _TURN) & (np.abs(turns[:, 0]) > _TIMES * np.abs(turns[:, 1]))
    leaping = (steps[:, 0] > _STEP) & (steps[:, 0] > _TIMES * steps[:, 1])
    broken = turning | leaping
    if broken.mean() <= 0.5:
        return healthy(patient)
    kind = "facing" if turning.mean() >= leaping.mean() / 2 else "position"
    metres, degrees = np.median(steps[broken, 0]) / patient.fps, np.rad2deg(np.median(np.abs(turns[broken, 0])))
    evidence = (
        f"from frame 0 to frame 1 the body of {of_motions(int(broken.sum()), patient)} turns by {degrees:.0f} degrees"
        f" and leaps by {metres:.2f} m (medians), and not in the frame after"
    )
    cause = "only the first frame is canonical: the initial pose was put before motions that live in another frame"
    remedy = "Give all frames the transform of the first (prbench.representation.canonicalise moves whole motions)."
    found = Diagnosis(kind, True, evidence, cause, remedy)
    joined = {row: _joined(patient.motions[row]) for row, is_broken in zip(long, broken, strict=True) if is_broken}
    return Finding(
        (found,), patient.with_motions([joined.get(row, motion) for row, motion in enumerate(patient.motions)])
    )


def _joined(motion: np.ndarray) -> np.ndarray:
    """The frames after the first moved rigidly, so that they go on from it."""
    turns = wrapped(np.diff(headings(motion[:3])))
    rest = turned(motion[1:], float(turns[1] - turns[0]))
    path = rest[:, Joint.PELVIS]
    rest += motion[0, Joint.PELVIS] + (path[1] - path[0]) - path[0]
    return np.concatenate([motion[:1], rest])
