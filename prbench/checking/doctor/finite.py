"""Numbers that are no positions: NaN, infinity, and frames without a body."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.patient import Finding, Patient, of_motions
from prbench.checking.doctor.types import Diagnosis

_POINT = 1e-6  # size of a pose that is nothing but one point, as a share of the body's size


def examine_finite(patient: Patient) -> Finding:
    """Find NaN, infinity and poses whose joints all lie in one point."""
    broken = [np.asarray(~np.isfinite(motion).all(axis=(1, 2))) for motion in patient.motions]
    empty = _empty(patient, broken)
    diagnoses = []
    if any(bad.any() for bad in broken):
        cause = "a division by zero, a square root of a negative number, or padding"
        remedy = "Leave the padding out; look for the first operation that gives NaN."
        diagnoses.append(
            Diagnosis("not-finite", True, _counted(patient, broken, "hold NaN or infinity"), cause, remedy)
        )
    if any(bad.any() for bad in empty):
        cause = "padding with zeros, or frames that were never written"
        remedy = "Return only the frames that were asked for, and all of them."
        evidence = _counted(patient, empty, "hold a single point instead of a body")
        diagnoses.append(Diagnosis("empty-frames", True, evidence, cause, remedy))
    if not diagnoses:
        return Finding((), patient)
    bad = [one | other for one, other in zip(broken, empty, strict=True)]
    rows = [row for row in range(len(patient)) if (~bad[row]).any()]
    mended = patient.only(rows).with_motions([_mended(patient.motions[row], bad[row]) for row in rows])
    if any(len(mended.motions[place]) != len(patient.motions[row]) for place, row in enumerate(rows)):
        mended = mended.without_lengths()
    return Finding(tuple(diagnoses), mended, hopeless=not rows)


def _empty(patient: Patient, broken: list[np.ndarray]) -> list[np.ndarray]:
    extents = [np.ptp(np.nan_to_num(motion), axis=1).max(axis=-1) for motion in patient.motions]
    usual = np.concatenate([extent[~bad] for extent, bad in zip(extents, broken, strict=True)])
    largest = float(usual.max()) if usual.size else 0.0
    return [(extent <= _POINT * largest) & ~bad for extent, bad in zip(extents, broken, strict=True)]


def _counted(patient: Patient, bad: list[np.ndarray], what: str) -> str:
    rows = [row for row in range(len(patient)) if bad[row].any()]
    frames = sum(int(bad[row].sum()) for row in rows)
    trailing = all(bad[row][int(np.argmax(bad[row])) :].all() for row in rows)
    where = "all of them at the end" if trailing else f"the first is frame {int(np.argmax(bad[rows[0]]))}"
    return f"{frames} frames of {of_motions(len(rows), patient)} {what}, {where}"


def _mended(motion: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """Bad frames at the end cut off, others filled in on a straight line between their neighbours."""
    good = np.flatnonzero(~bad)
    if len(good) == len(motion):
        return motion
    kept = motion[: good[-1] + 1]
    flat = kept.reshape(len(kept), -1)
    times = np.arange(len(kept))
    return np.stack([np.interp(times, good, column[good]) for column in flat.T], axis=1).reshape(kept.shape)
