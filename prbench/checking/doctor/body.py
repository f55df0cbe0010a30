"""Finds motions that are no bodies of human size in metres: shapes, features, units, and trembling."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.checking.doctor.motion_set import (
    NOTHING_KNOWN,
    OTHER_ORDERS,
    Diagnosis,
    Distances,
    Finding,
    MotionSet,
    fit,
    no_finding,
    on_straight_lines,
)
from prbench.geometry.skeleton import BONES, N_JOINTS, Joint, bone_lengths
from prbench.harness.methods.motions import wrong_unit
from prbench.representation import N_FEATURES, decode
from prbench.representation.converters import JOINT_MAPS

_SHAPELESS = 3.0  # times the spread of a coordinate; a body's joints have mean heights much farther apart
_FLABBY = 0.12  # change of the distances that change least, as a share of themselves
_POINT = 1e-6  # size of a pose that is nothing but one point, as a share of the body's size
_SCALED = 0.10  # deviation from the scale of the initial pose's bones


def examine_body(motion_set: MotionSet) -> Finding:
    """Require joints in different places on average, and bones that keep their lengths."""
    shape = _shape(motion_set)
    # The mean relative change of the distances that change least, as many as there are joints.
    distances = Distances.of(motion_set.motions)
    upper = np.triu_indices(len(distances.median), 1)
    relative = distances.spread[upper] / np.maximum(distances.median[upper], 1e-9)
    softness = float(np.sort(relative)[: len(distances.median)].mean())
    if shape >= _SHAPELESS or (softness < _FLABBY and shape > 1.0):
        return no_finding(motion_set)
    evidence = (
        f"mean places of the joints lie {shape:.1f} standard deviations apart (those of bodies more than"
        f" {_SHAPELESS:g}); the steadiest distances between joints vary by {softness:.0%}"
    )
    return Finding((not_positions(motion_set, evidence) or _noise(evidence),), motion_set, unreadable=True)


def not_positions(motion_set: MotionSet, evidence: str) -> Diagnosis | None:
    """Tell standardised positions and velocities from the size of the numbers; None for neither."""
    poses = motion_set.poses()
    middle = float(np.median(np.abs(poses.mean(axis=0))))
    spread = float(poses.std())
    numbers = f"{evidence}; the numbers have a standard deviation of {spread:.2g}, means of {middle:.2g} (median)"
    if spread < 0.2:
        cause = "these look like steps from frame to frame (velocities), not like positions"
        return Diagnosis("standardised", True, numbers, cause, "Add them up over time, beginning with the first pose.")
    if spread < 5 and middle < 2:
        cause = "the mean was subtracted and the standard deviation divided out, and neither was put back"
        remedy = "Undo it with the statistics of the training: joints * std + mean."
        return Diagnosis("standardised", True, numbers, cause, remedy)
    return None


def _noise(evidence: str) -> Diagnosis:
    remedy = "Undo the scaling of the training before the motions are handed over."
    return Diagnosis("standardised", True, evidence, "scaled features, offsets or noise instead of positions", remedy)


def _shape(motion_set: MotionSet) -> float:
    """Return the distance between mean joints on the axis that separates them best, in standard deviations."""
    poses = motion_set.poses()
    if len(poses) < 2:
        return np.inf
    apart = np.ptp(poses.mean(axis=0), axis=0)
    varied = np.median(poses.std(axis=0), axis=0)
    return float((apart / np.maximum(varied, 1e-9)).max())


def examine_finite(motion_set: MotionSet) -> Finding:
    """Find NaN, infinity and poses whose joints all lie in one point."""
    broken = [np.asarray(~np.isfinite(motion).all(axis=(1, 2))) for motion in motion_set.motions]
    extents = [np.ptp(np.nan_to_num(motion), axis=1).max(axis=-1) for motion in motion_set.motions]
    usual = np.concatenate([extent[~bad] for extent, bad in zip(extents, broken, strict=True)])
    largest = float(usual.max()) if usual.size else 0.0
    empty = [(extent <= _POINT * largest) & ~bad for extent, bad in zip(extents, broken, strict=True)]
    diagnoses = []
    if any(bad.any() for bad in broken):
        cause = "a division by zero, a square root of a negative number, or padding"
        remedy = "Leave the padding out; look for the first operation that gives NaN."
        diagnoses.append(
            Diagnosis("not-finite", True, _counted(motion_set, broken, "hold NaN or infinity"), cause, remedy)
        )
    if any(bad.any() for bad in empty):
        cause = "padding with zeros, or frames that were never written"
        remedy = "Return only the frames that were asked for, and all of them."
        evidence = _counted(motion_set, empty, "hold a single point instead of a body")
        diagnoses.append(Diagnosis("empty-frames", True, evidence, cause, remedy))
    if not diagnoses:
        return Finding((), motion_set)
    bad = [one | other for one, other in zip(broken, empty, strict=True)]
    rows = [row for row in range(len(motion_set)) if (~bad[row]).any()]
    mended = motion_set.only(rows).with_motions([_mended(motion_set.motions[row], bad[row]) for row in rows])
    # Cut frames change lengths, which would be reported as a second fault.
    if any(len(mended.motions[place]) != len(motion_set.motions[row]) for place, row in enumerate(rows)):
        mended = mended.without_lengths()
    return Finding(tuple(diagnoses), mended, unreadable=not rows)


def _counted(motion_set: MotionSet, bad: list[np.ndarray], what: str) -> str:
    rows = [row for row in range(len(motion_set)) if bad[row].any()]
    frames = sum(int(bad[row].sum()) for row in rows)
    trailing = all(bad[row][int(np.argmax(bad[row])) :].all() for row in rows)
    where = "all of them at the end" if trailing else f"the first is frame {int(np.argmax(bad[rows[0]]))}"
    return f"{frames} frames of {motion_set.in_words(len(rows))} {what}, {where}"


def _mended(motion: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """Cut bad frames off the end, and fill in the others on straight lines between their neighbours."""
    good = np.flatnonzero(~bad)
    if len(good) == len(motion):
        return motion
    return on_straight_lines(motion[good], good, np.arange(good[-1] + 1))


def examine_unit(motion_set: MotionSet) -> Finding:
    """Compare the size of bodies with that of people, whatever the axes and the order of joints are."""
    found = wrong_unit(motion_set.poses())
    if found is None:
        return no_finding(motion_set)
    diagnosis = Diagnosis("unit", True, found.evidence, found.cause, found.remedy)
    return Finding((diagnosis,), motion_set.changed(lambda motion: motion * found.metres_per_unit))


def examine_scale(motion_set: MotionSet) -> Finding:
    """Compare bones with those of the initial poses, where these are known; the order of joints has been found."""
    known = [row for row in range(len(motion_set)) if motion_set.expected[row].initial_joints is not None]
    if not known or motion_set.motions[0].shape[1] != N_JOINTS:
        return no_finding(motion_set)
    ratios = np.array([_size_ratio(motion_set.motions[row], motion_set.expected[row].initial_joints) for row in known])
    ratio = float(np.median(ratios))
    agreeing = float(np.ptp(np.percentile(ratios, [10, 90])))
    if abs(ratio - 1) < _SCALED or agreeing > _SCALED / 2:
        return no_finding(motion_set)
    evidence = f"bones are {ratio:.3f} times as long as those of the initial poses (10 to 90 %: ± {agreeing / 2:.3f})"
    cause = "positions were divided by a body height or put on a skeleton of another size"
    remedy = f"Divide the joints by {ratio:.3f}, or put them back on the initial pose's bones."
    found = Diagnosis("unit", True, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(lambda motion: motion / ratio))


def _size_ratio(motion: np.ndarray, pose: np.ndarray | None) -> float:
    assert pose is not None
    return float(bone_lengths(motion[:: max(1, len(motion) // 16)]).sum(axis=-1).mean() / bone_lengths(pose).sum())


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
        remedy = f"Let a body model make joints of them: {_CONVERT}.smpl_joints."
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


_TREMBLING = 1.2  # second over first differences (noise 1.7, movement 0.3)
_TREMOR = 0.003  # metres
SMOOTHED_OVER = 1.5
"""Standard deviation of the Gaussian in :func:`smoothed`, frames."""
_STRETCHY = 0.12  # standard deviation of a bone's length over time, as a share of it


@dataclass(frozen=True)
class Tremor:
    """Trembling of most motions; medians over them."""

    ratio: float
    """Second over first differences of the joints relative to the pelvis."""
    metres: float
    motions: int
    """Number of motions that were long enough."""

    @classmethod
    def of(cls, motions: Sequence[Float[np.ndarray, "_frames 22 3"]]) -> Tremor | None:
        """Measure motions; None if they do not tremble, or are too short to tell."""
        ratios = []
        sizes = []
        for motion in motions:
            if len(motion) <= 4:
                continue
            # Relative to the pelvis, whose own path may be smoothed by another part of a model.
            limbs = motion - motion[:, :1]
            first, second = (np.linalg.norm(np.diff(limbs, n, axis=0), axis=-1).mean(axis=-1) for n in (1, 2))
            ratios.append(float(np.median(second) / max(float(np.median(first)), 1e-9)))
            # The second difference of independent noise has a variance of 1 + 4 + 1 = 6 times its own.
            sizes.append(float(np.median(second)) / np.sqrt(6))
        if not ratios or np.median(ratios) < _TREMBLING or np.median(sizes) < _TREMOR:
            return None
        return cls(float(np.median(ratios)), float(np.median(sizes)), len(ratios))


def examine_quality(motion_set: MotionSet) -> Finding:
    """Look at bones and at how smoothly joints move."""
    long = [motion for motion in motion_set.motions if len(motion) > 4]
    if not long:
        return Finding((), motion_set)
    return Finding((*_stretching(long), *_trembling(long)), motion_set)


def _stretching(motions: list[np.ndarray]) -> tuple[Diagnosis, ...]:
    changes = []
    for motion in motions:
        lengths = bone_lengths(motion)
        changes.append(lengths.std(axis=0) / np.maximum(lengths.mean(axis=0), 1e-9))
    worst = np.max(changes, axis=1)
    if np.median(worst) < _STRETCHY:
        return ()
    bone = int(np.median(changes, axis=0).argmax())
    parent, child = (Joint(joint).name.lower() for joint in BONES[bone])
    evidence = (
        f"lengths of bones change by up to {np.median(worst):.0%} (standard deviation of the worst bone, median of"
        f" {len(motions)} motions); most from {parent} to {child}"
    )
    cause = "joints were generated or interpolated one by one, without a skeleton"
    remedy = "Decode through rotations (prbench.representation.decode_rotations), or add a loss on bones."
    return (Diagnosis("bones", False, evidence, cause, remedy),)


def _trembling(motions: list[np.ndarray]) -> tuple[Diagnosis, ...]:
    tremor = Tremor.of(motions)
    if tremor is None:
        return ()
    evidence = (
        f"joints tremble by about {tremor.metres * 1000:.0f} mm: steps change from frame to frame by"
        f" {tremor.ratio:.2f} of their own size (medians of {tremor.motions} motions;"
        " smooth movement 0.3, noise 1.7)"
    )
    cause = "noise of a sampler with few steps, or frames that are generated without their neighbours"
    remedy = "Sample with more steps or smooth the joints; metrics of the head and of feet suffer from it."
    return (Diagnosis("jitter", False, evidence, cause, remedy),)


def smoothed(motion: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "frames joints 3"]:
    """Smooth the motion over frames."""
    from scipy.ndimage import gaussian_filter1d  # late: 0.3 s that a run and its workers do not need

    return gaussian_filter1d(motion, SMOOTHED_OVER, axis=0, mode="nearest")
