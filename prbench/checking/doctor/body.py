"""Finds motions that are no bodies of human size in metres: shapes, features, units."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, fit, joint_distances, on_straight_lines
from prbench.geometry.skeleton import N_JOINTS, bone_lengths
from prbench.representation import N_FEATURES, decode
from prbench.representation.converters import JOINT_MAPS

_SHAPELESS = 3.0  # times the spread of a coordinate; a body's joints have mean heights much farther apart
_FLABBY = 0.12  # change of the distances that change least, as a share of themselves
_UNSTEADY = 0.25  # the same, beyond which rows of numbers are no positions at all
_POINT = 1e-6  # size of a pose that is nothing but one point, as a share of the body's size
_SCALED = 0.10  # deviation from the scale of the initial pose's bones
_SMALLEST = 0.65  # metres between the two joints of a human pose that lie farthest apart
_TYPICAL = 1.5
_LARGEST = 2.35
_NO_BODY = 1e-9
LARGEST_NUMBER = 1e12  # of a motion, in any unit; what is larger counts as infinity
_UNITS = (("millimetres", 1e-3), ("centimetres", 1e-2), ("inches", 0.0254), ("decimetres", 0.1), ("feet", 0.3048))
# Body parameters that have so many numbers a frame
BODY_PARAMETERS = {
    66: "22 rotations as axis-angle",
    69: "22 rotations as axis-angle and a translation",
    72: "SMPL: 24 rotations as axis-angle",
    75: "SMPL: 24 rotations as axis-angle and a translation",
    135: "22 rotations of six numbers and a translation",
    138: "22 rotations of six numbers and two translations",
    147: "24 rotations of six numbers and a translation",
    156: "SMPL-H: 52 rotations as axis-angle",
    159: "SMPL-H: 52 rotations as axis-angle and a translation",
    165: "SMPL-X: 55 rotations as axis-angle",
    168: "SMPL-X: 55 rotations as axis-angle and a translation",
    322: "SMPL-X: pose, face, translation and shape as Motion-X has them",
}
_CONVERT = "prbench.representation.converters"
_KNOWN_JOINTS = frozenset({N_JOINTS} | {len(each.source_joints) for each in JOINT_MAPS.values()})
# Other orders of axes than (frames, joints, 3): the transpose that mends it, its name, and the remedy
_PLANES = (
    ((0, 2, 1), "(frames, 3, joints)", "Exchange the last two axes: joints.transpose(0, 2, 1)."),
    ((2, 0, 1), "(joints, 3, frames), as in MDM's files", "Move frames to the front: joints.transpose(2, 0, 1)."),
    ((2, 1, 0), "(3, joints, frames)", "Turn the axes round: joints.transpose(2, 1, 0)."),
    ((1, 0, 2), "(joints, frames, 3)", "Exchange the first two axes: joints.transpose(1, 0, 2)."),
    ((1, 2, 0), "(3, frames, joints)", "Move the coordinates to the end: joints.transpose(1, 2, 0)."),
)


def examine_empty(motion_set: MotionSet) -> Finding | None:
    """Find arrays without numbers."""
    filled = [row for row, motion in enumerate(motion_set.motions) if motion.size]
    if len(filled) == len(motion_set):
        return None
    holes = f"{len(motion_set) - len(filled)} of {len(motion_set)} arrays hold no numbers"
    remedy = "Leave them out or generate them again."
    found = Diagnosis("shape", True, holes, "nothing was generated for them", remedy)
    return Finding((found,), motion_set.only(filled), unreadable=not filled)


def examine_shape(motion_set: MotionSet) -> Finding | None:
    """Bring motions to (frames, joints, 3) and say what that took."""
    if all(motion.shape[1:] == (N_JOINTS, 3) for motion in motion_set.motions):
        return None
    shapes = list(dict.fromkeys(str(motion.shape) for motion in motion_set.motions))
    more = f" and {len(shapes) - 3} more" if len(shapes) > 3 else ""
    evidence = f"expected (frames, 22, 3), found {', '.join(shapes[:3])}{more}"

    def without_single_axes(motion: np.ndarray) -> np.ndarray:
        # A motion of one frame keeps its first axis.
        if motion.shape[-2:] == (N_JOINTS, 3):
            return motion.reshape(-1, N_JOINTS, 3) if motion.ndim <= 3 or 1 in motion.shape[:-2] else motion
        return motion if motion.ndim <= 2 else np.squeeze(motion)

    squeezed = motion_set.changed(without_single_axes)
    if all(motion.ndim == 2 and N_FEATURES in motion.shape for motion in squeezed.motions):
        return _features(squeezed, evidence)
    first = squeezed.motions[0].shape
    in_place = all(motion.ndim == 3 and motion.shape[1:] == (*first[1:2], 3) for motion in squeezed.motions)
    reading = None if in_place and first[1] in _KNOWN_JOINTS else _reading(squeezed)
    if in_place and reading is None and first[1] > 8:
        # Another number of joints is left to examine_joint_order.
        if len(first) == motion_set.motions[0].ndim:
            return Finding((), squeezed)
        found = Diagnosis("shape", True, evidence, "axes of length one are left over", "Take them out: np.squeeze.")
        return Finding((found,), squeezed)
    if reading is not None:
        form, convert, remedy = reading
        found = Diagnosis("shape", True, evidence, f"the numbers stand as {form}", remedy)
        return Finding((found,), squeezed.changed(convert))
    if len(first) == 2 and first[1] in BODY_PARAMETERS:
        cause = f"parameters of a body, {BODY_PARAMETERS[first[1]]}"
        remedy = f"Let a body model make joints of them: {_CONVERT}.smpl_joints."
    else:
        cause = "no known way to write the joints of a body"
        remedy = f"Give positions of the 22 joints of HumanML3D, (frames, 22, 3); {_CONVERT} holds what helps."
    return Finding((Diagnosis("shape", True, evidence, cause, remedy),), motion_set, unreadable=True)


def _features(motion_set: MotionSet, evidence: str) -> Finding:
    rows = motion_set.changed(lambda motion: motion if motion.shape[-1] == N_FEATURES else motion.T)
    rotations = np.concatenate(rows.motions)[:, 67:193].reshape(-1, 6)
    lengths = np.linalg.norm(rotations[:, :3], axis=1)
    numbers = f"{evidence}; the 6-D rotations have columns of length {np.median(lengths):.2f} (1 in raw features)"
    # Columns of a rotation have length 1; after standardisation they have any other.
    if float(np.median(np.abs(lengths - 1))) < 0.1:
        remedy = f"Decode them: {_CONVERT}.joints_from_features(features, n_frames)."
        found = Diagnosis("features", True, numbers, "these are HumanML3D's 263 features, not joints", remedy)
        return Finding((found,), rows.changed(lambda motion: decode(motion).astype(np.float64)).without_lengths())
    remedy = "Multiply by the training's standard deviation and add its mean"
    remedy += f" ({_CONVERT}.read_feature_statistics), then decode: {_CONVERT}.joints_from_features."
    cause = "these are HumanML3D's 263 features, still standardised"
    return Finding((Diagnosis("features", True, numbers, cause, remedy),), motion_set, unreadable=True)


def _reading(motion_set: MotionSet) -> tuple[str, Callable[[np.ndarray], np.ndarray], str] | None:
    """Return form, conversion and remedy of the interpretation in which joints are most like a body, if one is."""
    shapes = {motion.shape for motion in motion_set.motions}
    if len({len(shape) for shape in shapes}) != 1:
        return None
    shape = next(iter(shapes))
    n_axes = len(shape)
    if n_axes == 3:
        for axes, form, remedy in _PLANES:
            alike = {(each[axes[1]], each[axes[2]]) for each in shapes} == {(shape[axes[1]], 3)}
            if alike and shape[axes[1]] in _KNOWN_JOINTS:
                return form, lambda motion, axes=axes: motion.transpose(axes), remedy
        return None
    joints = shape[-1] // 3
    widths = {motion.shape[-1] for motion in motion_set.motions}
    if n_axes != 2 or widths != {3 * joints} or joints not in _KNOWN_JOINTS:
        return None
    candidates = (
        (
            f"{joints} joints after one another, x y z each",
            lambda motion: motion.reshape(-1, joints, 3),
            f"Give every frame its joints: joints.reshape(-1, {joints}, 3).",
        ),
        (
            "all x, then all y, then all z",
            lambda motion: motion.reshape(-1, 3, joints).transpose(0, 2, 1),
            f"Give every frame its joints: joints.reshape(-1, 3, {joints}).transpose(0, 2, 1).",
        ),
    )
    # A few motions decide; the bones tell the two apart, and where no joint is known, how steady distances are.
    scores = []
    for _, convert, _ in candidates:
        distances = joint_distances([np.nan_to_num(convert(motion)) for motion in motion_set.motions[:8]])
        scores.append((fit(distances)[0] if joints == N_JOINTS else 0.0, softness(distances)))
    best = min(range(2), key=lambda place: scores[place])
    return candidates[best] if scores[best][1] < _UNSTEADY else None


def softness(distances: tuple[np.ndarray, np.ndarray]) -> float:
    """Return the mean relative change of the distances that change least, as many as there are joints."""
    median, spread = distances
    upper = np.triu_indices(len(median), 1)
    return float(np.sort(spread[upper] / np.maximum(median[upper], 1e-9))[: len(median)].mean())


def examine_finite(motion_set: MotionSet) -> Finding | None:
    """Find NaN, infinity and poses whose joints all lie in one point."""
    broken = [np.asarray(~np.isfinite(motion).all(axis=(1, 2))) for motion in motion_set.motions]
    extents = [np.ptp(np.nan_to_num(motion), axis=1).max(axis=-1) for motion in motion_set.motions]
    largest = max(float(extent[~bad].max(initial=0.0)) for extent, bad in zip(extents, broken, strict=True))
    empty = [(extent <= _POINT * largest) & ~bad for extent, bad in zip(extents, broken, strict=True)]
    diagnoses = []
    for bad, kind, what, cause, remedy in (
        (
            broken, "not-finite", f"hold NaN, infinity or numbers beyond {LARGEST_NUMBER:g}",
            "a division by zero, a square root of a negative number, or padding",
            "Leave the padding out; look for the first operation that gives NaN.",
        ),
        (
            empty, "empty-frames", "hold a single point instead of a body",
            "padding with zeros, or frames that were never written",
            "Return only the frames that were asked for, and all of them.",
        ),
    ):  # fmt: skip
        if rows := [row for row in range(len(motion_set)) if bad[row].any()]:
            frames = sum(int(bad[row].sum()) for row in rows)
            first = int(np.argmax(bad[rows[0]]))
            where = "all of them at the end" if bad[rows[0]][first:].all() else f"the first is frame {first}"
            evidence = f"{frames} frames of {motion_set.in_words(len(rows))} {what}, {where}"
            diagnoses.append(Diagnosis(kind, True, evidence, cause, remedy))
    if not diagnoses:
        return None
    # Bad frames at the end are cut off, others filled in on straight lines. Cut frames change lengths, which would be
    # reported as a second fault.
    good = [np.flatnonzero(~(one | other)) for one, other in zip(broken, empty, strict=True)]
    rows = [row for row in range(len(motion_set)) if good[row].size]
    motions = [motion_set.motions[row] for row in rows]
    mended = []
    for row, motion in zip(rows, motions, strict=True):
        mended.append(on_straight_lines(motion[good[row]], good[row], np.arange(good[row][-1] + 1)))
    rest = motion_set.only(rows).with_motions(mended)
    if [len(motion) for motion in motions] != [len(motion) for motion in mended]:
        rest = rest.without_lengths()
    return Finding(tuple(diagnoses), rest, unreadable=not rows)


def examine_body(motion_set: MotionSet) -> Finding | None:
    """Require joints in different places on average, and bones that keep their lengths."""
    poses = motion_set.poses()
    # The distance between mean joints on the axis that separates them best, in standard deviations.
    apart = np.ptp(poses.mean(axis=0), axis=0)
    varied = np.median(poses.std(axis=0), axis=0)
    shape = float((apart / np.maximum(varied, 1e-9)).max()) if len(poses) > 1 else np.inf
    soft = softness(motion_set.distances)
    if shape >= _SHAPELESS or (soft < _FLABBY and shape > 1.0):
        return None
    evidence = f"mean places of the joints lie {shape:.1f} standard deviations apart (those of bodies more than"
    evidence += f" {_SHAPELESS:g}); the steadiest distances between joints vary by {soft:.0%}"
    remedy = "Undo the scaling of the training before the motions are handed over."
    cause = "scaled features, offsets or noise instead of positions"
    found = not_positions(motion_set, evidence) or Diagnosis("standardised", True, evidence, cause, remedy)
    return Finding((found,), motion_set, unreadable=True)


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


def examine_unit(motion_set: MotionSet) -> Finding | None:
    """Compare the size of bodies with that of people, whatever the axes and the order of joints are."""
    found = wrong_unit(motion_set.poses())
    if found is None:
        return None
    diagnosis, metres_per_unit = found
    return Finding((diagnosis,), motion_set.changed(lambda motion: motion * metres_per_unit))


def wrong_unit(poses: Float[np.ndarray, "poses joints 3"]) -> tuple[Diagnosis, float] | None:
    """Name the unit that bodies seem to be in; axes and the order of joints do not matter.

    Returns:
        The diagnosis, and the factor that makes metres of the numbers; None where bodies are of human size in metres or
        have no size.
    """
    # The median over poses of the largest distance between two joints, in the unit of the poses.
    size = float(np.median(np.linalg.norm(poses[:, :, None] - poses[:, None], axis=-1).max(axis=(1, 2))))
    if size < _NO_BODY or _SMALLEST <= size <= _LARGEST:
        return None
    evidence = f"the joints of a pose lie up to {size:.4g} apart (median); those of people 0.65 to 2.35 m"
    # Several units may fit; the one that makes the body most usual wins.
    fits = [unit for unit in _UNITS if _SMALLEST <= size * unit[1] <= _LARGEST]
    if fits:
        name, factor = min(fits, key=lambda unit: abs(np.log(size * unit[1] / _TYPICAL)))
        cause = f"positions are in {name}"
        remedy = f"Multiply the joints by {factor:g}: prbench wants metres."
    else:
        factor = _TYPICAL / size
        cause = "positions were divided by a height or a standard deviation, or are in a unit of their own"
        remedy = f"Undo the scaling before the motions are handed over; a factor near {factor:.3g} gives people's size."
    return Diagnosis("unit", True, evidence, cause, remedy), factor


def examine_scale(motion_set: MotionSet) -> Finding | None:
    """Compare bones with those of the initial poses, where these are known; the order of joints has been found."""
    ratios = [
        bone_lengths(motion[:: max(1, len(motion) // 16)]).sum(axis=-1).mean()
        / bone_lengths(known.initial_joints).sum()
        for motion, known in zip(motion_set.motions, motion_set.expected, strict=True)
        if known.initial_joints is not None
    ]
    if not ratios:
        return None
    ratio = float(np.median(ratios))
    agreeing = float(np.ptp(np.percentile(ratios, [10, 90])))
    if abs(ratio - 1) < _SCALED or agreeing > _SCALED / 2:
        return None
    evidence = f"bones are {ratio:.3f} times as long as those of the initial poses (10 to 90 %: ± {agreeing / 2:.3f})"
    cause = "positions were divided by a body height or put on a skeleton of another size"
    remedy = f"Divide the joints by {ratio:.3f}, or put them back on the initial pose's bones."
    found = Diagnosis("unit", True, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(lambda motion: motion / ratio))
