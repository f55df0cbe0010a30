"""Recognises arrays of other shapes than (frames, 22, 3): flat frames, swapped axes, features, body parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.anatomy import Distances, fit
from prbench.checking.doctor.motion_set import NOTHING_KNOWN, Diagnosis, Finding, MotionSet, no_finding
from prbench.checking.doctor.orders import OTHER_ORDERS
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.representation import N_FEATURES, decode
from prbench.representation.converters import JOINT_MAPS

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
_KNOWN_JOINTS = frozenset(
    {N_JOINTS}
    | {len(order.joints) for order in OTHER_ORDERS}
    | {len(each.source_joints) for each in JOINT_MAPS.values()}
)


@dataclass(frozen=True)
class _Reading:
    """An interpretation of an array."""

    form: str
    convert: Callable[[np.ndarray], np.ndarray]
    """Turns the array into (frames, joints, 3)."""
    remedy: str


def examine_shape(motion_set: MotionSet) -> Finding:
    """Bring motions to (frames, joints, 3) and say what that took."""
    motion_set = _unbatched(motion_set)
    shape = motion_set.motions[0].shape
    if all(motion.ndim == 3 and motion.shape[1:] == (N_JOINTS, 3) and len(motion) for motion in motion_set.motions):
        return no_finding(motion_set)
    evidence = f"expected (frames, 22, 3), found {_shown(motion_set)}"
    if empty := sum(motion.size == 0 for motion in motion_set.motions):
        holes = f"{empty} of {len(motion_set)} arrays hold no numbers"
        remedy = "Leave them out or generate them again."
        found = Diagnosis("shape", True, holes, "nothing was generated for them", remedy)
        if empty == len(motion_set):
            return Finding((found,), motion_set, unreadable=True)
        rest = examine_shape(motion_set.only([row for row, motion in enumerate(motion_set.motions) if motion.size]))
        return Finding((found, *rest.diagnoses), rest.motion_set, rest.unreadable)
    squeezed = motion_set.changed(_squeezed)
    if all(motion.ndim == 2 and N_FEATURES in motion.shape for motion in squeezed.motions):
        return _features(squeezed, evidence)
    reading = _best_reading(squeezed.motions)
    if reading is None:
        return Finding((_unknown(squeezed, evidence),), motion_set, unreadable=True)
    read = squeezed.changed(reading.convert)
    if not reading.form and squeezed.motions[0].shape == shape:
        return no_finding(read)  # another number of joints only: the order of joints is looked at later
    cause = f"the numbers stand as {reading.form}" if reading.form else "axes of length one are left over"
    return Finding((Diagnosis("shape", True, evidence, cause, reading.remedy),), read)


def _unbatched(motion_set: MotionSet) -> MotionSet:
    """Split arrays with a batch axis into one motion for each row; expectations then fit no row."""
    if not any(_has_batch_axis(motion.shape) for motion in motion_set.motions):
        return motion_set
    rows: list[np.ndarray] = []
    for motion in motion_set.motions:
        rows += list(motion) if _has_batch_axis(motion.shape) else [motion]
    known = motion_set.expected if len(rows) == len(motion_set) else (NOTHING_KNOWN,) * len(rows)
    return dataclasses.replace(motion_set, motions=tuple(rows), expected=known)


def _has_batch_axis(shape: tuple[int, ...]) -> bool:
    if len(shape) == 4:
        return 1 not in shape[:2]
    flat = shape[-1] in (3 * N_JOINTS, N_FEATURES, *_BODY_PARAMETERS) or shape[-2:][0] == N_FEATURES
    return len(shape) == 3 and flat and 3 not in shape and 1 not in shape


def _squeezed(motion: np.ndarray) -> np.ndarray:
    """Drop axes of length one, except where a motion has a single frame."""
    if motion.ndim <= 3 and (motion.shape[-2:] == (N_JOINTS, 3) or (motion.ndim == 2 and motion.shape[0] == 1)):
        return motion.reshape(-1, *motion.shape[-2:]) if motion.shape[-2:] == (N_JOINTS, 3) else motion
    return np.squeeze(motion)


def _features(motion_set: MotionSet, evidence: str) -> Finding:
    rows = motion_set.changed(lambda motion: motion if motion.shape[-1] == N_FEATURES else motion.T)
    pooled = np.concatenate(rows.motions)
    rotations = pooled[:, 67:193].reshape(-1, 6)
    lengths = np.linalg.norm(rotations[:, :3], axis=1)
    # Columns of a rotation have length 1; after standardisation they have any other.
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
    return Finding((Diagnosis("features", True, numbers, cause, remedy),), motion_set, unreadable=True)


def _unknown(motion_set: MotionSet, evidence: str) -> Diagnosis:
    width = motion_set.motions[0].shape[-1] if motion_set.motions[0].ndim == 2 else 0
    if width in _BODY_PARAMETERS:
        remedy = f"Let a body model make joints of them: {_CONVERT}.smpl_joints, or SmplxModel through smplx."
        return Diagnosis("shape", True, evidence, f"parameters of a body, {_BODY_PARAMETERS[width]}", remedy)
    remedy = f"Give positions of the 22 joints of HumanML3D, (frames, 22, 3); {_CONVERT} holds what helps."
    return Diagnosis("shape", True, evidence, "no known way to write the joints of a body", remedy)


def _shown(motion_set: MotionSet) -> str:
    shapes = list(dict.fromkeys(str(motion.shape) for motion in motion_set.motions))
    return ", ".join(shapes[:3]) + (f" and {len(shapes) - 3} more" if len(shapes) > 3 else "")


def _best_reading(motions: tuple[np.ndarray, ...]) -> _Reading | None:
    """Return the interpretation of all arrays in which joints move most smoothly and keep their distances best."""
    shapes = [motion.shape for motion in motions]
    if len({len(shape) for shape in shapes}) != 1:
        return None
    candidates = _readings_of_planes(shapes) if len(shapes[0]) == 3 else _readings_of_rows(shapes)
    some = motions[:8]
    if not candidates:
        return None
    # A few motions decide; all are converted once the reading is chosen.
    read = {reading: tuple(reading.convert(motion) for motion in some) for reading in candidates}
    restless = {reading: _restlessness(joints) for reading, joints in read.items()}
    best = min(candidates, key=lambda reading: (not _is_a_body(read[reading]), restless[reading]))
    return best if len(shapes[0]) == 3 or restless[best] < 0.25 else None


def _is_a_body(motions: tuple[np.ndarray, ...]) -> bool:
    """Return True if the bones are people's, in HumanML3D's order."""
    if motions[0].shape[1] != N_JOINTS:
        return False
    finite = tuple(np.nan_to_num(motion) for motion in motions)
    return fit(Distances.of(finite), {joint.name.lower(): joint.value for joint in Joint}).misfit < 0.3


def _readings_of_planes(shapes: list[tuple[int, ...]]) -> list[_Reading]:
    readings = []
    for order, form, remedy in (
        ((0, 1, 2), "", ""),
        ((0, 2, 1), "(frames, 3, joints)", "Exchange the last two axes: joints.transpose(0, 2, 1)."),
        ((2, 0, 1), "(joints, 3, frames), as in MDM's files", "Move frames to the front: joints.transpose(2, 0, 1)."),
        ((2, 1, 0), "(3, joints, frames)", "Turn the axes round: joints.transpose(2, 1, 0)."),
        ((1, 0, 2), "(joints, frames, 3)", "Exchange the first two axes: joints.transpose(1, 0, 2)."),
        ((1, 2, 0), "(3, frames, joints)", "Move the coordinates to the end: joints.transpose(1, 2, 0)."),
    ):
        _, joints, coordinates = order
        numbers = {(shape[joints], shape[coordinates]) for shape in shapes}
        if len(numbers) == 1 and shapes[0][joints] in _KNOWN_JOINTS and shapes[0][coordinates] == 3:
            readings.append(_Reading(form, lambda motion, order=order: motion.transpose(order), remedy))
    # A skeleton without a map is still a body: joint_order.py says what to do with it.
    one_number = {shape[1:] for shape in shapes} == {(shapes[0][1], 3)}
    if not readings and one_number and shapes[0][1] > 8:
        readings.append(_Reading("", lambda motion: motion, ""))
    return readings


def _readings_of_rows(shapes: list[tuple[int, ...]]) -> list[_Reading]:
    width = shapes[0][-1]
    joints = width // 3
    one_width = all(shape[-1] == width for shape in shapes)
    if len(shapes[0]) != 2 or not one_width or width % 3 or joints not in _KNOWN_JOINTS:
        return []
    by_axis = f"joints.reshape(-1, 3, {joints}).transpose(0, 2, 1)"
    return [
        _Reading(
            f"{joints} joints after one another, x y z each",
            lambda motion: motion.reshape(-1, joints, 3),
            f"Give every frame its joints: joints.reshape(-1, {joints}, 3).",
        ),
        _Reading(
            "all x, then all y, then all z",
            lambda motion: motion.reshape(-1, 3, joints).transpose(0, 2, 1),
            f"Give every frame its joints: {by_axis}.",
        ),
    ]


def _restlessness(motions: tuple[np.ndarray, ...]) -> float:
    """Return how much a body's distances change between frames, as a share of its size; small if axes are right."""
    changes = []
    for motion in motions:
        some = np.nan_to_num(motion[: min(len(motion), 64)])
        apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
        size = np.median(apart.max(axis=(1, 2)))
        relative = apart.std(axis=0) / np.maximum(apart.mean(axis=0), 1e-9)
        rigid = np.sort(relative[np.triu_indices(len(relative), 1)])
        steps = np.abs(np.diff(some, axis=0)).mean() / max(float(size), 1e-9) if len(some) > 1 else 0.0
        changes.append(float(rigid[: len(relative)].mean()) + float(steps))
    return float(np.median(changes))
