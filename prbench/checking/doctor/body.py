"""Checks that the numbers are positions of a body in metres: finite, not standardised, no velocities."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.anatomy import Distances
from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding, on_straight_lines
from prbench.geometry.skeleton import N_JOINTS, bone_lengths
from prbench.harness.methods.coordinates import wrong_unit

_SHAPELESS = 3.0  # times the spread of a coordinate; a body's joints have mean heights much farther apart
_FLABBY = 0.12  # change of the distances that change least, as a share of themselves
_POINT = 1e-6  # size of a pose that is nothing but one point, as a share of the body's size
_SCALED = 0.10  # deviation from the scale of the initial pose's bones


def examine_body(motion_set: MotionSet) -> Finding:
    """Require joints in different places on average, and bones that keep their lengths."""
    shape = _shape(motion_set)
    softness = _softness(motion_set)
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


def _softness(motion_set: MotionSet) -> float:
    """Return the mean relative change of the distances that change least, as many as there are joints."""
    distances = Distances.of(motion_set.motions)
    upper = np.triu_indices(len(distances.median), 1)
    relative = distances.spread[upper] / np.maximum(distances.median[upper], 1e-9)
    return float(np.sort(relative)[: len(distances.median)].mean())


def examine_finite(motion_set: MotionSet) -> Finding:
    """Find NaN, infinity and poses whose joints all lie in one point."""
    broken = [np.asarray(~np.isfinite(motion).all(axis=(1, 2))) for motion in motion_set.motions]
    empty = _empty(motion_set, broken)
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


def _empty(motion_set: MotionSet, broken: list[np.ndarray]) -> list[np.ndarray]:
    extents = [np.ptp(np.nan_to_num(motion), axis=1).max(axis=-1) for motion in motion_set.motions]
    usual = np.concatenate([extent[~bad] for extent, bad in zip(extents, broken, strict=True)])
    largest = float(usual.max()) if usual.size else 0.0
    return [(extent <= _POINT * largest) & ~bad for extent, bad in zip(extents, broken, strict=True)]


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
