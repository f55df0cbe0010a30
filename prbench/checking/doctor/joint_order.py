"""Finds joints in another order, and left and right exchanged or mirrored."""

from __future__ import annotations

import numpy as np

from prbench.checking.doctor import motion_set as measures
from prbench.checking.doctor.body import not_positions
from prbench.checking.doctor.motion_set import Diagnosis, Finding, MotionSet
from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench.representation.converters import JOINT_MAPS
from prbench.representation.encoding import MIRRORED_JOINTS

# Misfit of the bones: right bodies have 0.03 to 0.15, shuffled ones 0.6.
_FITS = 0.3
_IMPOSSIBLE = 0.4
_ALIKE = 0.03  # difference of two orders that only exchange left and right
_CROSSED = -0.3  # agreement of a pair with the hips, 1 always and -1 never on their side
_GAIN = 0.0015  # of the bones' misfit by an exchange
_WRONG_SIDE = -0.5  # mean cosine between the front of toes and knees and the one that left and right say
_TOLD_APART = 0.005  # metres between an initial pose and its mirror image
_LEFTS = [joint for joint in Joint if joint.name.startswith("LEFT")]
_PARTS = [joint.name.removeprefix("LEFT_").lower() for joint in _LEFTS]
_ARMS = np.array([part in ("collar", "shoulder", "elbow", "wrist") for part in _PARTS])
_NOT_HIPS = np.array([part != "hip" for part in _PARTS])


def examine_joint_order(motion_set: MotionSet) -> Finding | None:
    """Find the order under which the bones are those of people and keep their lengths."""
    distances = motion_set.distances
    if len(distances[0]) != N_JOINTS:
        return _another_number(motion_set, len(distances[0]))
    own, _ = measures.fit(distances)
    if own < _IMPOSSIBLE:
        return _exchanged_pairs(motion_set, distances)
    fits = {name: measures.fit(distances, measures.index_of(joints)) for name, joints in measures.ORDERS_OF_22.items()}
    best = min(fits, key=lambda name: sum(fits[name]))
    evidence = f"as HumanML3D's order, bones miss people's lengths by {own:.0%}"
    if fits[best][0] >= _FITS:
        evidence += f", in every known order by more than {_FITS:.0%}"
        cause = "an order or a skeleton that is not known, or no positions"
        remedy = "Check that joints are positions in space, in the order of prbench.geometry.skeleton.Joint."
        found = not_positions(motion_set, evidence) or Diagnosis("joint-order", True, evidence, cause, remedy)
        return Finding((found,), motion_set, unreadable=True)
    # Orders that only exchange left and right have bones alike; the front tells which of them is right.
    alike = [name for name in fits if sum(fits[name]) < sum(fits[best]) + _ALIKE]
    poses = motion_set.poses()
    orders = {name: measures.index_of(measures.ORDERS_OF_22[name]) for name in alike}
    best = max(alike, key=lambda name: np.sign(measures.sidedness(poses[:, orders[name]]).mean().round(1)))
    index = orders[best]
    evidence += f"; in the order found by {fits[best][0]:.0%}"
    remedy = f"Put them into HumanML3D's order: joints[:, {index}] (names: prbench.geometry.skeleton.Joint)."
    found = Diagnosis("joint-order", True, evidence, f"joints stand in {best}", remedy)
    return Finding((found,), motion_set.changed(lambda motion: motion[:, index]))


def _another_number(motion_set: MotionSet, n_joints: int) -> Finding:
    """Name the skeleton that prbench has a map for, if it is one."""
    evidence = f"{n_joints} joints a frame instead of 22"
    fitting = {name: each for name, each in JOINT_MAPS.items() if len(each.source_joints) == n_joints}
    mapped = {name: motion_set.changed(each.to_22) for name, each in fitting.items()}
    misfits = {name: sum(measures.fit(each.distances)) for name, each in mapped.items()}
    best = min(misfits, key=lambda name: misfits[name], default="")
    if misfits.get(best, np.inf) >= _FITS:
        remedy = "Write a map of its joints (prbench.representation.converters.JointMap) to prbench.geometry.skeleton."
        found = Diagnosis("joint-order", True, evidence, "a skeleton of its own", remedy)
        return Finding((found,), motion_set, unreadable=True)
    evidence += f"; as '{best}', bones miss people's lengths by {misfits[best]:.0%}"
    remedy = f"Convert them: prbench.representation.converters.joint_map('{best}').to_22(joints)."
    if best.startswith("smpl"):
        remedy += " That is joints[:, :22]."
    found = Diagnosis("joint-order", True, evidence, f"the joints are those of the skeleton '{best}'", remedy)
    return Finding((found,), mapped[best])


def _exchanged_pairs(motion_set: MotionSet, distances: tuple[np.ndarray, np.ndarray]) -> Finding | None:
    """Find single parts, such as the ankles, whose left and right are exchanged against the rest of their limb."""
    agreement = _agreement_with_hips(motion_set)
    crossed = agreement < _CROSSED
    if (crossed == _NOT_HIPS).all():
        crossed = ~crossed
    if not crossed.any() or (crossed == _ARMS).all() or (crossed == ~_ARMS).all():
        return None  # whole limbs are examine_left_right's
    index = _with_sides(crossed)
    before = sum(measures.fit(distances))
    after = sum(measures.fit(distances, index))
    if after > min(before - _GAIN, _FITS):
        return None
    names = " and ".join(part for part, swap in zip(_PARTS, crossed, strict=True) if swap)
    evidence = f"left and right of {names} lie the other way round than the hips (agreement"
    evidence += f" {agreement[crossed].min():.2f}; 1 is full); exchanged, bones miss people's lengths by {after:.1%}"
    evidence += f" instead of {before:.1%}"
    cause = f"left and right of {names} are exchanged, the others are not"
    found = Diagnosis("joint-order", True, evidence, cause, f"Exchange them: joints[:, {index}].")
    return Finding((found,), motion_set.changed(lambda motion: motion[:, index]))


def _agreement_with_hips(motion_set: MotionSet) -> np.ndarray:
    """Return for each part how often its left lies on the side of the left hip: 1 always, -1 never; (8 parts,)."""
    poses = motion_set.poses()
    hips = measures.unit(poses[:, Joint.LEFT_HIP] - poses[:, Joint.RIGHT_HIP])
    rights = [MIRRORED_JOINTS[joint] for joint in _LEFTS]
    sideways = ((poses[:, _LEFTS] - poses[:, rights]) * hips[:, None]).sum(axis=-1)
    return sideways.mean(axis=0) / np.maximum(np.abs(sideways).mean(axis=0), 1e-9)


def _with_sides(exchanged: np.ndarray) -> list[int]:
    """Return the index that exchanges left and right of some parts."""
    index = list(range(N_JOINTS))
    for left, swap in zip(_LEFTS, exchanged, strict=True):
        if swap:
            index[left], index[MIRRORED_JOINTS[left]] = MIRRORED_JOINTS[left], int(left)
    return index


def examine_left_right(motion_set: MotionSet) -> Finding | None:
    """Compare the front that toes, knees and head show with the one that follows from left and right."""
    poses = motion_set.poses()
    by_hips = float(measures.sidedness(poses).mean())
    by_shoulders = float(measures.sidedness(poses, "SHOULDER").mean())
    if by_hips > _WRONG_SIDE and by_shoulders > _WRONG_SIDE:
        return None
    evidence = f"where toes, knees and head point has a mean cosine of {by_hips:+.2f} with the front that left and"
    evidence += f" right hip give, {by_shoulders:+.2f} with that of the shoulders"
    # Hips and shoulders disagree: only the arms or only the legs are exchanged.
    if by_hips * by_shoulders < 0:
        if _agreement_with_hips(motion_set)[_ARMS].mean() > _WRONG_SIDE:
            return None  # turned trunks, not exchanged names
        arms = by_shoulders < by_hips
        index = _with_sides(_ARMS if arms else ~_ARMS)
        limbs, others = ("arms", "legs") if arms else ("legs", "arms")
        cause = f"the names of the left and right {limbs} are exchanged, those of the {others} are not"
        found = Diagnosis("left-right", True, evidence, cause, f"Exchange them: joints[:, {index}].")
        return Finding((found,), motion_set.changed(lambda motion: motion[:, index]))
    # Where the toes point backwards too, negating that axis undoes both, and exchanging names would undo one.
    backwards = float(measures.front(motion_set.first_poses())[:, 2].mean()) < 0
    signs = np.array((1.0, 1.0, -1.0) if backwards else (-1.0, 1.0, 1.0))
    flip = f"joints * [{', '.join(f'{sign:g}' for sign in signs)}]"
    exchange = "Exchange the names: joints[:, prbench.representation.encoding.MIRRORED_JOINTS]."
    mirrored, reason = _is_mirrored(motion_set)
    if mirrored is None:
        kind = "left-right"
        cause = "left and right joints are exchanged, or the world is mirrored (an axis negated, or two exchanged);"
        cause += " for a symmetric body the two give the same numbers"
        remedy = f"{exchange} If the world is mirrored instead: {flip}."
    elif mirrored:
        kind = "mirrored"
        cause = f"the world is mirrored ({reason})"
        remedy = f"Undo the mirroring, for instance {flip}; check where two axes were exchanged without a sign."
    else:
        kind = "left-right"
        cause = f"left and right joints are exchanged ({reason})"
        remedy = exchange
    found = Diagnosis(kind, True, evidence, cause, remedy)
    if mirrored or backwards:
        return Finding((found,), motion_set.changed(lambda motion: motion * signs))
    return Finding((found,), motion_set.changed(lambda motion: motion[:, list(MIRRORED_JOINTS)]))


def _is_mirrored(motion_set: MotionSet) -> tuple[bool | None, str]:
    """Return True for a mirrored world, False for exchanged names, None if no initial pose tells; and the reason."""
    both = zip(motion_set.motions, motion_set.expected, strict=True)
    pairs = [(motion[0], known.initial_joints) for motion, known in both if known.initial_joints is not None]
    if not pairs:
        return None, ""
    first, initial = (np.stack(poses) for poses in zip(*pairs, strict=True))

    def apart(poses: np.ndarray) -> float:
        """Return the mean distance of joints relative to their pelvises, metres."""
        return float(np.linalg.norm((poses - poses[:, :1]) - (initial - initial[:, :1]), axis=-1).mean())

    in_mirror = min(apart(first * signs) for signs in ((-1, 1, 1), (1, 1, -1)))
    exchanged = apart(first[:, list(MIRRORED_JOINTS)])
    if max(in_mirror, exchanged) < 1.5 * min(in_mirror, exchanged) + _TOLD_APART:
        return None, ""
    reason = f"the initial pose is {in_mirror:.2f} m away in a mirror, {exchanged:.2f} m with names exchanged"
    return in_mirror < exchanged, reason
