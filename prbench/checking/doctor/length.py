"""Motions of another length than was asked for."""

from __future__ import annotations

import dataclasses

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, healthy, of_motions
from prbench.checking.doctor.remedies import AT_RATE
from prbench.checking.doctor.resample import at_length
from prbench.checking.doctor.types import Diagnosis

_AGREEING = 0.02  # spread of the logarithm of the ratio
_NEAR = 0.025
_RATES = (5.0, 10.0, 12.0, 12.5, 15.0, 20.0, 24.0, 25.0, 29.97, 30.0, 40.0, 50.0, 59.94, 60.0, 90.0, 100.0, 120.0)


def examine_length(patient: Patient) -> Finding:
    """Compare numbers of frames: a common ratio is another frame rate, a common number is a fixed window."""
    known = [row for row, expected in enumerate(patient.expected) if expected.n_frames is not None]
    found = np.array([len(patient.motions[row]) for row in known])
    asked = np.array([patient.expected[row].n_frames for row in known])
    wrong = found != asked
    if not wrong.any():
        return healthy(patient)
    lines = f"another length in {of_motions(int(wrong.sum()), patient)}, {_example(found, asked)}"
    ratios = np.log((found - 1).clip(1) / (asked - 1).clip(1))
    ratio = float(np.exp(np.median(ratios)))
    differences = found - asked
    undone = patient
    kind, remedy = "length", "Return as many frames as were asked for (n_frames)."
    if (differences[wrong] == -1).all():
        cause = "the last frame is missing: 263 features hold a step to the next frame and lose one"
        remedy += " Encode one frame more, or repeat none: extrapolate the last."
    elif wrong.all() and (rate := _rate(patient.fps * ratio)) and np.ptp(ratios) < _AGREEING + 4 / float(found.min()):
        kind, cause = "frame-rate", f"motions have {rate:g} frames a second, {patient.fps:g} were asked for"
        remedy = AT_RATE
        undone = _stretched(patient, known)
    elif len(set(found.tolist())) == 1 and len(set(asked.tolist())) > 1:
        cause = f"every motion has {found[0]} frames: a fixed window of the model, or padding that was not cut off"
    else:
        cause = "motions end where the model stopped, or were stretched by a factor that is no usual frame rate"
    diagnosis = Diagnosis(kind, True, lines, cause, remedy)
    return Finding((diagnosis,), undone)


def _example(found: np.ndarray, asked: np.ndarray) -> str:
    row = int(np.argmax(found != asked))
    ratio = np.median((found - 1).clip(1) / (asked - 1).clip(1))
    return f"such as {found[row]} frames instead of {asked[row]}; time is stretched by {ratio:.3f} (median)"


def _rate(exact: float) -> float | None:
    """The usual rate that a measured one is, if it is one."""
    nearest = min(_RATES, key=lambda rate: abs(np.log(rate / exact)))
    return nearest if abs(np.log(nearest / exact)) < _NEAR else None


def _stretched(patient: Patient, known: list[int]) -> Patient:
    motions = list(patient.motions)
    for row in known:
        n_frames = patient.expected[row].n_frames
        if n_frames is not None and len(motions[row]) > 1:
            motions[row] = at_length(motions[row], n_frames)
    return dataclasses.replace(patient, motions=tuple(motions))
