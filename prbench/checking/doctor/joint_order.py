"""Finds joints in another order, and left and right exchanged or mirrored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, product

import numpy as np

from prbench.checking.doctor.body import not_positions
from prbench.checking.doctor.motion_set import (
    BONE_ENDS,
    BONE_LENGTHS,
    ORDERS_OF_22,
    OTHER_ORDERS,
    PARTS,
    Diagnosis,
    Distances,
    Finding,
    MotionSet,
    Order,
    fit,
    front,
    left_of_hips,
    left_of_shoulders,
    no_finding,
    sidedness,
    sideways_agreement,
    with_sides,
)
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint, bone_lengths
from prbench.randomness import named_generator
from prbench.representation import REST_OFFSETS
from prbench.representation.converters import JOINT_MAPS
from prbench.representation.encoding import MIRRORED_JOINTS

_STARTS = 120
_LOOSENESS = 0.5  # of the last guess: how much chance may change a joint's likeness
_GOOD = 0.16  # misfit that shuffled joints do not reach by chance
_PART_OF = np.array([PARTS.index(joint.name.lower().split("_")[-1]) if "_" in joint.name else -1 for joint in Joint])
_CHOICES = np.array([[part >= 0 and bits[part] for part in _PART_OF] for bits in product((False, True), repeat=8)])
"""(256, 22); one row for each choice of exchanged parts, True where a joint takes its mirror image's place."""
_SIZES = (1.65, 1.45, 1.25)  # metres between the joints of a pose that lie farthest apart: standing, working, sitting
_REST = np.zeros((N_JOINTS, 3))
for _joint in range(1, N_JOINTS):
    _REST[_joint] = _REST[PARENTS[_joint]] + REST_OFFSETS[_joint]
_STANDING = np.linalg.norm(_REST[:, None] - _REST, axis=-1)
"""Distances between the joints of a body that stands with its arms hanging."""
_SWAPS = np.array(list(combinations(range(N_JOINTS), 2)))
_OWN = Order("HumanML3D", tuple(joint.name.lower() for joint in Joint))
# Misfit of the bones: right bodies have 0.03 to 0.15, shuffled ones 0.6.
_FITS = 0.3
_IMPOSSIBLE = 0.4
_ALIKE = 0.03  # difference of two orders that only exchange left and right
# Agreement of a pair with the hips (anatomy.sideways_agreement).
_CROSSED = -0.3
_NOT_CROSSED = 0.5
# Gain of the bones' misfit by an exchange: where pairs lie crossed, and where they do not.
_GAIN = 0.0015
_CLEAR_GAIN = 0.012
_ARMS = np.array([part in ("collar", "shoulder", "elbow", "wrist") for part in PARTS])
_NOT_HIPS = np.array([part != "hip" for part in PARTS])


def examine_joint_order(motion_set: MotionSet) -> Finding:
    """Find the order under which the bones are those of people and keep their lengths."""
    distances = Distances.of(motion_set.motions)
    n_joints = len(distances.median)
    if n_joints != N_JOINTS:
        # Diagnose another number of joints: try the skeletons that prbench has maps for, then those that it only knows.
        n_joints = len(distances.median)
        evidence = f"{n_joints} joints a frame instead of 22"
        fitting = {name: each for name, each in JOINT_MAPS.items() if len(each.source_joints) == n_joints}
        mapped = {name: motion_set.changed(each.to_22) for name, each in fitting.items()}
        misfits = {name: _badness(Distances.of(each.motions), range(N_JOINTS)) for name, each in mapped.items()}
        best = min(misfits, key=lambda name: misfits[name], default=None)
        if best is not None and misfits[best] < _FITS:
            evidence += f"; as '{best}', bones miss people's lengths by {misfits[best]:.0%}"
            remedy = f"Convert them: prbench.representation.converters.named_skeletons('{best}').to_22(joints)."
            if best.startswith("smpl"):
                remedy += " That is joints[:, :22]."
            found = Diagnosis("joint-order", True, evidence, f"the joints are those of the skeleton '{best}'", remedy)
            return Finding((found,), mapped[best])
        known = {each: fit(distances, each.places()).misfit for each in OTHER_ORDERS if len(each.joints) == n_joints}
        order = min(known, key=lambda each: known[each], default=None)
        if order is not None and known[order] < 2 * _FITS:
            evidence += f"; as {order.name}, bones miss people's lengths by {known[order]:.0%}"
            found = Diagnosis("joint-order", True, evidence, f"the skeleton is that of {order.name}", order.remedy)
            return Finding((found,), motion_set, unreadable=True)
        remedy = "Write a map of its joints (prbench.representation.converters.JointMap) to prbench.geometry.skeleton."
        return Finding(
            (Diagnosis("joint-order", True, evidence, "a skeleton of its own", remedy),), motion_set, unreadable=True
        )
    own = fit(distances, _OWN.places())
    if own.misfit < _IMPOSSIBLE:
        return _exchanged_pairs(motion_set, distances)
    fits = {order: fit(distances, order.places()) for order in ORDERS_OF_22}
    best = min(fits, key=lambda order: fits[order].badness)
    if fits[best].misfit < _FITS:
        alike = [order for order in fits if fits[order].badness < fits[best].badness + _ALIKE]
        best = max(alike, key=lambda order: _side(motion_set, order.index()))
        return _reordered(motion_set, best.index(), own.misfit, fits[best].misfit, f"joints stand in {best.name}")
    index = _recovered(motion_set, distances)
    if index is not None:
        misfit = fit(distances, {name: index[place] for place, name in enumerate(_OWN.joints)}).misfit
        return _reordered(motion_set, index, own.misfit, misfit, "joints stand in an order of their own")
    return _no_body(motion_set, own.misfit)


def _recovered(motion_set: MotionSet, distances: Distances) -> list[int] | None:
    """Recover an unknown order, with left and right where the body's front and hips have them."""
    index = _recovered_order(distances)
    if index is None:
        return None
    crossed = sideways_agreement(motion_set.poses()[:, index]) < 0
    index = with_sides(index, crossed)
    return with_sides(index, ~np.zeros_like(crossed)) if _side(motion_set, index) < 0 else index


def _side(motion_set: MotionSet, index: Sequence[int]) -> float:
    """Return 1 if left is left of the front under an order, -1 if it is right of it, 0 if unclear."""
    poses = motion_set.poses()[:, list(index)]
    return float(np.sign(sidedness(poses, left_of_hips(poses)).mean().round(1)))


def _reordered(motion_set: MotionSet, index: Sequence[int], before: float, after: float, cause: str) -> Finding:
    evidence = f"as HumanML3D's order, bones miss people's lengths by {before:.0%}; in the order found by {after:.0%}"
    remedy = f"Put them into HumanML3D's order: joints[:, {list(index)}] (names: prbench.geometry.skeleton.Joint)."
    found = Diagnosis("joint-order", True, evidence, cause, remedy)
    return Finding((found,), motion_set.changed(lambda motion: motion[:, list(index)]))


def _exchanged_pairs(motion_set: MotionSet, distances: Distances) -> Finding:
    """Find single parts, such as the ankles, whose left and right are exchanged against the rest of their limb."""
    agreement = sideways_agreement(motion_set.poses())
    before = fit(distances, _OWN.places()).badness
    crossed = agreement < _CROSSED
    gain = _GAIN
    if (crossed == _NOT_HIPS).all():
        crossed = ~crossed
    elif crossed.any() and not (crossed == _ARMS).all():
        crossed = _best_exchange(distances, crossed)
    if not crossed.any():
        crossed = _best_exchange(distances, _NOT_HIPS)
        gain = _CLEAR_GAIN
        crossed = crossed if (agreement[crossed] < _NOT_CROSSED).all() else np.zeros_like(crossed)
    if (crossed == _ARMS).all() or (crossed == ~_ARMS).all() or not crossed.any():
        return no_finding(motion_set)  # whole limbs: left_right.py
    index = with_sides(range(N_JOINTS), crossed)
    after = _badness(distances, index)
    if after > min(before - gain, _FITS):
        return no_finding(motion_set)
    names = " and ".join(
        "feet" if part == "foot" else f"{part}s" for part, swap in zip(PARTS, crossed, strict=True) if swap
    )
    evidence = (
        f"left and right {names} lie the other way round than the hips"
        f" (agreement {agreement[crossed].min():.2f}; 1 is full);"
        f" exchanged, bones miss people's lengths by {after:.1%} instead of {before:.1%}"
    )
    remedy = f"Exchange them: joints[:, {index}]."
    found = Diagnosis(
        "joint-order", True, evidence, f"left and right {names} are exchanged, the others are not", remedy
    )
    return Finding((found,), motion_set.changed(lambda motion: motion[:, index]))


def _best_exchange(distances: Distances, parts: np.ndarray) -> np.ndarray:
    """Return the choice of exchanged parts that gives the best bones."""
    choices = [parts & np.array(bits) for bits in product((False, True), repeat=len(PARTS))]
    unique = list({tuple(choice): choice for choice in choices}.values())
    return min(unique, key=lambda choice: _badness(distances, with_sides(range(N_JOINTS), choice)))


def _badness(distances: Distances, index: Sequence[int]) -> float:
    return fit(distances, {name: index[place] for place, name in enumerate(_OWN.joints)}).badness


def _no_body(motion_set: MotionSet, misfit: float) -> Finding:
    evidence = f"bones miss people's lengths by {misfit:.0%}, in every known order by more than {_FITS:.0%}"
    standardised = not_positions(motion_set, evidence)
    if standardised is not None:
        return Finding((standardised,), motion_set, unreadable=True)
    remedy = "Check that joints are positions in space, and their order against prbench.geometry.skeleton.Joint."
    found = Diagnosis(
        "joint-order", True, evidence, "an order or a skeleton that is not known, or no positions", remedy
    )
    return Finding((found,), motion_set, unreadable=True)


def _recovered_order(distances: Distances) -> list[int] | None:
    """The index that puts 22 joints into HumanML3D's order, or None if none gives a body.

    Exchanges pairs of joints as long as bones get better, from many starts. Distances alone do not tell left from
    right.
    """
    best = None
    lowest = np.inf
    confirmed = 0
    generator = named_generator("doctor", "joint order")
    for start in range(_STARTS):
        cost = _cost(distances, distances.median.max() / _SIZES[start % len(_SIZES)])
        index, value = _descended(_guess(distances, _LOOSENESS * (start / _STARTS), generator), cost)
        if value < lowest + 0.06:  # near enough that exchanging whole limbs may help
            # The best of an order's relatives, improved as far as exchanging single joints goes.
            relatives = _relatives(index)
            index, value = _descended(relatives[int(cost(relatives).argmin())], cost)
        confirmed += abs(value - lowest) < 1e-9
        if value < lowest - 1e-9:
            best = index
            lowest = value
            confirmed = 0
        if lowest < _GOOD and confirmed == 3:
            break
    if best is None or lowest > _GOOD:
        return None
    candidates = _relatives(best)
    return [int(joint) for joint in candidates[int(_misfit_at_own_size(distances, candidates).argmin())]]


def _misfit_at_own_size(distances: Distances, orders: np.ndarray) -> np.ndarray:
    """Return the cost of each order if its body may have any size."""
    one, other = BONE_ENDS
    ends = orders[:, one], orders[:, other]
    lengths = distances.median[ends]
    people = BONE_LENGTHS * (lengths.sum(axis=1, keepdims=True) / BONE_LENGTHS.sum())
    return (np.abs(lengths - people) + distances.spread[ends]).sum(axis=1) / people.sum(axis=1)


def _guess(distances: Distances, looseness: float, generator: np.random.Generator) -> np.ndarray:
    """Assign joints one after another by how alike their distances to all others are to those in a standing body."""
    here = _profiles(distances.median)
    there = _profiles(_STANDING)
    unlike = np.abs(here[None] - there[:, None]).mean(axis=-1)
    unlike += looseness * unlike.mean() * generator.standard_normal(unlike.shape)
    order = np.empty(N_JOINTS, dtype=int)
    for _ in range(N_JOINTS):
        place, joint = np.unravel_index(unlike.argmin(), unlike.shape)
        order[place] = joint
        unlike[place] = np.inf
        unlike[:, joint] = np.inf
    return order


def _profiles(apart: np.ndarray) -> np.ndarray:
    return np.sort(apart / apart.max(), axis=1)


def _cost(distances: Distances, scale: float) -> Callable[[np.ndarray], np.ndarray]:
    one, other = BONE_ENDS
    people = BONE_LENGTHS * scale

    def cost(orders: np.ndarray) -> np.ndarray:
        ends = orders[:, one], orders[:, other]
        return (np.abs(distances.median[ends] - people) + distances.spread[ends]).sum(axis=1) / people.sum()

    return cost


def _descended(order: np.ndarray, cost: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, float]:
    value = float(cost(order[None])[0])
    rows = np.arange(len(_SWAPS))
    while True:
        neighbours = np.repeat(order[None], len(_SWAPS), axis=0)
        neighbours[rows, _SWAPS[:, 0]], neighbours[rows, _SWAPS[:, 1]] = order[_SWAPS[:, 1]], order[_SWAPS[:, 0]]
        values = cost(neighbours)
        best = int(values.argmin())
        if values[best] >= value - 1e-12:
            return order, value
        order = neighbours[best]
        value = float(values[best])


def _relatives(order: np.ndarray) -> np.ndarray:
    """Return all orders that exchange left and right of single parts, such as both knees, or an ankle and its foot."""
    variants = [order]
    for ankle, foot in ((Joint.LEFT_ANKLE, Joint.LEFT_FOOT), (Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT)):
        for variant in tuple(variants):  # a shin is about as long as from the knee to the toes
            other = variant.copy()
            other[[ankle, foot]] = variant[[foot, ankle]]
            variants.append(other)
    return np.concatenate([np.where(_CHOICES, each[list(MIRRORED_JOINTS)], each) for each in variants])


_WRONG_SIDE = -0.5  # mean cosine between the front of toes and knees and the one that left and right say
_ASYMMETRIC = 0.004  # mean log ratio of left to right bones
_ALIKE_SIDES = 0.9  # correlation of these ratios with SMPL's
_ARMS_OF_SIDES = np.array([part in ("collar", "shoulder", "elbow", "wrist") for part in PARTS])


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
    agreement = sideways_agreement(motion_set.poses())[_ARMS_OF_SIDES].mean()
    if agreement > _WRONG_SIDE:
        return no_finding(motion_set)  # turned trunks, not exchanged names
    index = with_sides(range(N_JOINTS), _ARMS_OF_SIDES if arms else ~_ARMS_OF_SIDES)
    limbs = "arms" if arms else "legs"
    cause = f"the names of the left and right {limbs} are exchanged, those of the {'legs' if arms else 'arms'} are not"
    found = Diagnosis("left-right", True, evidence, cause, f"Exchange them: joints[:, {index}].")
    return Finding((found,), motion_set.changed(lambda motion: motion[:, index]))


def _whole(motion_set: MotionSet, evidence: str) -> Finding:
    toes_backwards = float(front(motion_set.first_poses())[:, 2].mean()) < 0
    mirrored, reason = _is_mirrored(motion_set)
    swap = "joints[:, prbench.representation.encoding.MIRRORED_JOINTS]"
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
    # Decide by the bones: SMPL's bodies are not quite symmetric, their right hip is longer than the left one.
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
    if abs(alike) < _ALIKE_SIDES:
        return None, ""
    return alike > 0, f"left and right bones differ as SMPL's do{'' if alike > 0 else ', the other way round'}"


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
