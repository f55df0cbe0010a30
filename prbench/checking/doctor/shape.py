"""Arrays of other shapes than (frames, 22, 3): flat frames, swapped axes, features, body parameters."""

from __future__ import annotations

import dataclasses

import numpy as np

from prbench.checking.doctor.array_forms import best_reading
from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.types import NOTHING_KNOWN, Diagnosis
from prbench.representation import N_FEATURES, decode
from prbench.skeleton import N_JOINTS

_BODY_PARAMETERS = {
    72: "SMPL: 24 rotations as axis-angle",
    75: "SMPL: 24 rotations as axis-angle and a translation",
    66: "22 rotations as axis-angle",
    69: "22 rotations as axis-angle and a translation",
    156: "SMPL-H: 52 rotations as axis-angle",
    159: "SMPL-H: 52 rotations as axis-angle and a translation",
    165: "SMPL-X: 55 rotations as axis-angle",
    168: "SMPL-X: 55 rotations as axis-angle and a translation",
    135: "22 rotations of six numbers and a translation",
    138: "22 rotations of six numbers and two translations",
    147: "24 rotations of six numbers and a translation",
    322: "SMPL-X: pose, face, translation and shape as Motion-X has them",
}
_CONVERT = "prbench.representation.converters"


def examine_shape(patient: Patient) -> Finding:
    """Bring motions to (frames, joints, 3) and say what that took."""
    patient = _unbatched(patient)
    shape = patient.motions[0].shape
    if all(motion.ndim == 3 and motion.shape[1:] == (N_JOINTS, 3) and len(motion) for motion in patient.motions):
        return healthy(patient)
    evidence = f"expected (frames, 22, 3), found {_shown(patient)}"
    if any(motion.size == 0 for motion in patient.motions):
        empty = sum(motion.size == 0 for motion in patient.motions)
        holes = f"{empty} of {len(patient)} arrays hold no numbers"
        remedy = "Leave them out or generate them again."
        found = Diagnosis("shape", True, holes, "nothing was generated for them", remedy)
        if empty == len(patient):
            return Finding((found,), patient, hopeless=True)
        rest = examine_shape(patient.only([row for row, motion in enumerate(patient.motions) if motion.size]))
        return Finding((found, *rest.diagnoses), rest.patient, rest.hopeless)
    squeezed = patient.changed(_squeezed)
    if all(motion.ndim == 2 and N_FEATURES in motion.shape for motion in squeezed.motions):
        return _features(squeezed, evidence)
    reading = best_reading(squeezed.motions)
    if reading is None:
        return Finding((_unknown(squeezed, evidence),), patient, hopeless=True)
    read = squeezed.changed(reading.convert)
    if not reading.form and squeezed.motions[0].shape == shape:
        return healthy(read)  # another number of joints only: the order of joints is looked at later
    cause = f"the numbers stand as {reading.form}" if reading.form else "axes of length one are left over"
    return Finding((Diagnosis("shape", True, evidence, cause, reading.remedy),), read)


def _unbatched(patient: Patient) -> Patient:
    """Arrays with a batch axis as one motion a row; what was expected then belongs to no row."""
    if not any(_has_batch_axis(motion.shape) for motion in patient.motions):
        return patient
    rows = [row for motion in patient.motions for row in (motion if _has_batch_axis(motion.shape) else [motion])]
    known = patient.expected if len(rows) == len(patient) else (NOTHING_KNOWN,) * len(rows)
    return dataclasses.replace(patient, motions=tuple(rows), expected=known)


def _has_batch_axis(shape: tuple[int, ...]) -> bool:
    if len(shape) == 4:
        return 1 not in shape[:2]
    flat = shape[-1] in (3 * N_JOINTS, N_FEATURES, *_BODY_PARAMETERS) or shape[-2:][0] == N_FEATURES
    return len(shape) == 3 and flat and 3 not in shape and 1 not in shape


def _squeezed(motion: np.ndarray) -> np.ndarray:
    """Without axes of length one, except where a motion has a single frame."""
    if motion.ndim <= 3 and (motion.shape[-2:] == (N_JOINTS, 3) or (motion.ndim == 2 and motion.shape[0] == 1)):
        return motion.reshape(-1, *motion.shape[-2:]) if motion.shape[-2:] == (N_JOINTS, 3) else motion
    return np.squeeze(motion)


def _features(patient: Patient, evidence: str) -> Finding:
    rows = patient.changed(lambda motion: motion if motion.shape[-1] == N_FEATURES else motion.T)
    pooled = np.concatenate(rows.motions)
    rotations = pooled[:, 67:193].reshape(-1, 6)
    lengths = np.linalg.norm(rotations[:, :3], axis=1)
    off = float(np.median(np.abs(lengths - 1)))
    numbers = f"{evidence}; the 6-D rotations have columns of length {np.median(lengths):.2f} (1 in raw features)"
    if off < 0.1:
        remedy = f"Decode them: {_CONVERT}.joints_from_features(features, n_frames)."
        found = Diagnosis("features", True, numbers, "these are HumanML3D's 263 features, not joints", remedy)
        decoded = rows.changed(lambda motion: decode(motion).astype(np.float64))
        return Finding((found,), decoded.without_lengths())
    remedy = (
        "Multiply by the training's standard deviation and add its mean"
        f" ({_CONVERT}.read_feature_statistics), then decode: {_CONVERT}.joints_from_features."
    )
    cause = "these are HumanML3D's 263 features, still standardised"
    return Finding((Diagnosis("features", True, numbers, cause, remedy),), patient, hopeless=True)


def _unknown(patient: Patient, evidence: str) -> Diagnosis:
    width = patient.motions[0].shape[-1] if patient.motions[0].ndim == 2 else 0
    if width in _BODY_PARAMETERS:
        remedy = f"Let a body model make joints of them: {_CONVERT}.smpl_joints, or SmplxModel through smplx."
        return Diagnosis("shape", True, evidence, f"parameters of a body, {_BODY_PARAMETERS[width]}", remedy)
    remedy = f"Give positions of the 22 joints of HumanML3D, (frames, 22, 3); {_CONVERT} holds what helps."
    return Diagnosis("shape", True, evidence, "no known way to write the joints of a body", remedy)


def _shown(patient: Patient) -> str:
    shapes = list(dict.fromkeys(str(motion.shape) for motion in patient.motions))
    return ", ".join(shapes[:3]) + (f" and {len(shapes) - 3} more" if len(shapes) > 3 else "")
