"""Finds left and right exchanged, by name or by a mirrored world."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor.anatomy import (
    PARTS,
    front,
    left_of_hips,
    left_of_shoulders,
    sidedness,
    sideways_agreement,
    with_sides,
)
from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet, no_finding
from prbench.geometry.skeleton import N_JOINTS, bone_lengths
from prbench.representation import REST_OFFSETS
from prbench.representation.clips import MIRRORED_JOINTS

_WRONG_SIDE = -0.5  # mean cosine between the front of toes and knees and the one that left and right say
_ASYMMETRIC = 0.004  # mean log ratio of left to right bones
_ALIKE = 0.9  # correlation of these ratios with SMPL's
_ARMS = np.array([part in ("collar", "shoulder", "elbow", "wrist") for part in PARTS])


def examine_left_right(motion_set: MotionSet) -> Finding:
    """Compare the front that toes, knees and head show with the one that follows from left and right."""
    poses = motion_set.poses()
    by_hips = float(sidedness(poses, left_of_hips(poses)).mean())
    by_shoulders = float(sidedness(poses, left_of_shoulders(poses)).mean())
    if by_hips > _WRONG_SIDE and by_shoulders > _WRONG_SIDE:
        return no_finding(motion_set)
    evidence = (
        "where toes, knees and head point has a mean cosine of"
        f" {by_hips:+.2f} with the front that left and right hip give, {by_shoulders:+.2f} with that of the shoulders"
    )
    # Hips and shoulders disagree: only the arms or only the legs are exchanged.
    if by_hips * by_shoulders < 0:
        return _half(motion_set, evidence, arms=by_shoulders < by_hips)
    return _whole(motion_set, evidence)


def _half(motion_set: MotionSet, evidence: str, *, arms: bool) -> Finding:
    agreement = sideways_agreement(motion_set.poses())[_ARMS].mean()
    if agreement > _WRONG_SIDE:
        return no_finding(motion_set)  # turned trunks, not exchanged names
    index = with_sides(range(N_JOINTS), _ARMS if arms else ~_ARMS)
    limbs = "arms" if arms else "legs"
    cause = f"the names of the left and right {limbs} are exchanged, those of the {'legs' if arms else 'arms'} are not"
    found = Diagnosis("left-right", True, evidence, cause, f"Exchange them: joints[:, {index}].")
    return Finding((found,), motion_set.changed(lambda motion: motion[:, index]))


def _whole(motion_set: MotionSet, evidence: str) -> Finding:
    toes_backwards = float(front(motion_set.first_poses())[:, 2].mean()) < 0
    mirrored, reason = _is_mirrored(motion_set)
    swap = "joints[:, prbench.representation.clips.MIRRORED_JOINTS]"
    axis = 2 if toes_backwards else 0
    flip = f"joints * [{'1, 1, -1' if toes_backwards else '-1, 1, 1'}]"
    remedy_mirrored = f"Undo the mirroring, for instance {flip}; check where two axes were exchanged without a sign."
    remedy_names = f"Exchange the names: {swap}."
    if mirrored is None:
        cause = (
            "left and right joints are exchanged, or the world is mirrored (an axis negated, or two exchanged);"
            " for a symmetric body the two give the same numbers"
        )
        kind = "left-right"
        remedy = f"{remedy_names} If the world is mirrored instead: {flip}."
    elif mirrored:
        kind = "mirrored"
        cause = f"the world is mirrored ({reason})"
        remedy = remedy_mirrored
    else:
        kind = "left-right"
        cause = f"left and right joints are exchanged ({reason})"
        remedy = remedy_names
    # Where the toes point backwards too, negating that axis undoes both, and exchanging names would undo one.
    undo_by_axis = mirrored or toes_backwards
    signs = np.where(np.arange(3) == axis, -1.0, 1.0)
    found = Diagnosis(kind, True, evidence, cause, remedy)
    if undo_by_axis:
        return Finding((found,), motion_set.changed(lambda motion: motion * signs))
    return Finding((found,), motion_set.changed(lambda motion: motion[:, list(MIRRORED_JOINTS)]))


def _is_mirrored(motion_set: MotionSet) -> tuple[bool | None, str]:
    """Return True for a mirrored world, False for exchanged names, None if nothing tells; and the reason."""
    for source, judged in (("initial pose", _by_initial_pose(motion_set)), ("goal", _by_goal(motion_set))):
        if judged is not None:
            mirrored, one, other = judged
            return mirrored, f"the {source} is {one:.2f} m away in a mirror, {other:.2f} m with names exchanged"
    return _by_bones(motion_set)


def _by_initial_pose(motion_set: MotionSet) -> tuple[bool, float, float] | None:
    """Compare first frames with initial poses in both ways."""
    pairs = [
        (motion[0], known.initial_joints)
        for motion, known in zip(motion_set.motions, motion_set.expected, strict=True)
        if known.initial_joints is not None
    ]
    if not pairs:
        return None
    first, initial = (np.stack(poses) for poses in zip(*pairs, strict=True))
    in_mirror = min(_apart(first * signs, initial) for signs in ((-1, 1, 1), (1, 1, -1)))
    exchanged = _apart(first[:, list(MIRRORED_JOINTS)], initial)
    return _decided(in_mirror, exchanged)


def _by_goal(motion_set: MotionSet) -> tuple[bool, float, float] | None:
    """Compare where wrists end with goals in both ways."""
    pairs = [
        (motion[-1, 20:22], known.goal_location)
        for motion, known in zip(motion_set.motions, motion_set.expected, strict=True)
        if known.goal_location is not None
    ]
    if not pairs:
        return None
    wrists, goals = (np.stack(points) for points in zip(*pairs, strict=True))

    def missed(points: np.ndarray) -> float:
        return float(np.median(np.linalg.norm(points - goals[:, None], axis=-1).min(axis=1)))

    return _decided(min(missed(wrists * signs) for signs in ((-1, 1, 1), (1, 1, -1))), missed(wrists))


def _decided(in_mirror: float, exchanged: float) -> tuple[bool, float, float] | None:
    if max(in_mirror, exchanged) < 1.5 * min(in_mirror, exchanged) + 0.01:
        return None
    return in_mirror < exchanged, in_mirror, exchanged


def _apart(poses: np.ndarray, others: np.ndarray) -> float:
    """Return the median distance of joints relative to their pelvises, metres."""
    difference = (poses - poses[:, :1]) - (others - others[:, :1])
    return float(np.median(np.linalg.norm(difference, axis=-1)))


def _by_bones(motion_set: MotionSet) -> tuple[bool | None, str]:
    """Decide by the bones: SMPL's bodies are not quite symmetric, their right hip is longer than the left one."""
    # Logarithms: ratios of left to right do not depend on the size of the body.
    lengths = np.log(np.maximum(bone_lengths(motion_set.poses()).mean(axis=0), 1e-6))
    people = np.log(np.linalg.norm(REST_OFFSETS[1:], axis=1))
    one = [joint - 1 for joint, mirrored in enumerate(MIRRORED_JOINTS) if joint < mirrored]
    other = [MIRRORED_JOINTS[joint + 1] - 1 for joint in one]
    here = lengths[one] - lengths[other]
    there = people[one] - people[other]
    if np.abs(here).mean() < _ASYMMETRIC:
        return None, ""
    alike = float(np.corrcoef(here, there)[0, 1])
    if abs(alike) < _ALIKE:
        return None, ""
    return alike > 0, f"left and right bones differ as SMPL's do{'' if alike > 0 else ', the other way round'}"
