"""Joints in another order than HumanML3D's, or of another skeleton."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from prbench.checking.doctor.anatomy import PARTS, left_of_hips, sidedness, sideways_agreement, with_sides
from prbench.checking.doctor.body import not_positions
from prbench.checking.doctor.bones import Distances, fit
from prbench.checking.doctor.orders import ORDERS_OF_22, OTHER_ORDERS, Order
from prbench.checking.doctor.patient import Finding, Patient, healthy
from prbench.checking.doctor.recover_order import recovered_order
from prbench.checking.doctor.types import Diagnosis
from prbench.representation.converters import JOINT_MAPS
from prbench.skeleton import N_JOINTS, Joint

_OWN = Order("HumanML3D", tuple(joint.name.lower() for joint in Joint))
_FITS, _IMPOSSIBLE = 0.3, 0.4  # misfit of the bones; right bodies have 0.03 to 0.15, shuffled ones 0.6
_ALIKE = 0.03  # difference of two orders that only exchange left and right
_CROSSED, _NOT_CROSSED = -0.3, 0.5  # agreement of a pair with the hips (anatomy.sideways_agreement)
_GAIN, _CLEAR_GAIN = 0.0015, 0.012  # of the bones' misfit: where pairs lie crossed, and where they do not
_ARMS = np.array([part in ("collar", "shoulder", "elbow", "wrist") for part in PARTS])
_NOT_HIPS = np.array([part != "hip" for part in PARTS])


def examine_joint_order(patient: Patient) -> Finding:
    """Find the order under which the bones are those of people and keep their lengths."""
    distances = Distances.of(patient.motions)
    n_joints = len(distances.median)
    if n_joints != N_JOINTS:
        return _another_skeleton(patient, distances)
    own = fit(distances, _OWN.places())
    if own.misfit < _IMPOSSIBLE:
        return _exchanged_pairs(patient, distances)
    fits = {order: fit(distances, order.places()) for order in ORDERS_OF_22}
    best = min(fits, key=lambda order: fits[order].badness)
    if fits[best].misfit < _FITS:
        alike = [order for order in fits if fits[order].badness < fits[best].badness + _ALIKE]
        best = max(alike, key=lambda order: _side(patient, order.index()))
        return _reordered(patient, best.index(), own.misfit, fits[best].misfit, f"joints stand in {best.name}")
    index = _recovered(patient, distances)
    if index is not None:
        misfit = fit(distances, {name: index[place] for place, name in enumerate(_OWN.joints)}).misfit
        return _reordered(patient, index, own.misfit, misfit, "joints stand in an order of their own")
    return _no_body(patient, own.misfit)


def _recovered(patient: Patient, distances: Distances) -> list[int] | None:
    """An order of its own, with left and right where the body's front and hips have them."""
    index = recovered_order(distances)
    if index is None:
        return None
    crossed = sideways_agreement(patient.poses()[:, index]) < 0
    index = with_sides(index, crossed)
    return with_sides(index, ~np.zeros_like(crossed)) if _side(patient, index) < 0 else index


def _side(patient: Patient, index: Sequence[int]) -> float:
    """Whether left is left of the front under an order: 1 if so, -1 if not."""
    poses = patient.poses()[:, list(index)]
    return float(np.sign(sidedness(poses, left_of_hips(poses)).mean().round(1)))


def _reordered(patient: Patient, index: Sequence[int], before: float, after: float, cause: str) -> Finding:
    evidence = f"as HumanML3D's order, bones miss people's lengths by {before:.0%}; in the order found by {after:.0%}"
    remedy = f"Put them into HumanML3D's order: joints[:, {list(index)}] (names: prbench.skeleton.Joint)."
    found = Diagnosis("joint-order", True, evidence, cause, remedy)
    return Finding((found,), patient.changed(lambda motion: motion[:, list(index)]))


def _another_skeleton(patient: Patient, distances: Distances) -> Finding:
    """Another number of joints: try the skeletons that prbench has maps for, then those that it only knows."""
    n_joints = len(distances.median)
    evidence = f"{n_joints} joints a frame instead of 22"
    mapped = {
        name: tuple(each.to_22(motion) for motion in patient.motions)
        for name, each in JOINT_MAPS.items()
        if len(each.source_joints) == n_joints
    }
    misfits = {name: _badness(Distances.of(motions), range(N_JOINTS)) for name, motions in mapped.items()}
    best = min(misfits, key=lambda name: misfits[name], default=None)
    if best is not None and misfits[best] < _FITS:
        evidence += f"; as '{best}', bones miss people's lengths by {misfits[best]:.0%}"
        remedy = f"Convert them: prbench.representation.converters.joint_map('{best}').to_22(joints)."
        if best.startswith("smpl"):
            remedy += " That is joints[:, :22]."
        found = Diagnosis("joint-order", True, evidence, f"the joints are those of the skeleton '{best}'", remedy)
        return Finding((found,), patient.with_motions(mapped[best]))
    known = {each: fit(distances, each.places()).misfit for each in OTHER_ORDERS if len(each.joints) == n_joints}
    order = min(known, key=lambda each: known[each], default=None)
    if order is not None and known[order] < 2 * _FITS:
        evidence += f"; as {order.name}, bones miss people's lengths by {known[order]:.0%}"
        found = Diagnosis("joint-order", True, evidence, f"the skeleton is that of {order.name}", order.remedy)
        return Finding((found,), patient, hopeless=True)
    remedy = "Write a map of its joints (prbench.representation.converters.JointMap); the 22 are in prbench.skeleton."
    return Finding((Diagnosis("joint-order", True, evidence, "a skeleton of its own", remedy),), patient, hopeless=True)


def _exchanged_pairs(patient: Patient, distances: Distances) -> Finding:
    """Single parts, such as the ankles, whose left and right are exchanged against the rest of their limb."""
    agreement = sideways_agreement(patient.poses())
    before = fit(distances, _OWN.places()).badness
    crossed, gain = agreement < _CROSSED, _GAIN
    if (crossed == _NOT_HIPS).all():
        crossed = ~crossed
    elif crossed.any() and not (crossed == _ARMS).all():
        crossed = _best_exchange(distances, crossed)
    if not crossed.any():
        crossed, gain = _best_exchange(distances, _NOT_HIPS), _CLEAR_GAIN
        crossed = crossed if (agreement[crossed] < _NOT_CROSSED).all() else np.zeros_like(crossed)
    if (crossed == _ARMS).all() or (crossed == ~_ARMS).all() or not crossed.any():
        return healthy(patient)  # whole limbs: left_right.py
    index = with_sides(range(N_JOINTS), crossed)
    after = _badness(distances, index)
    if after > min(before - gain, _FITS):
        return healthy(patient)
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
    return Finding((found,), patient.changed(lambda motion: motion[:, index]))


def _best_exchange(distances: Distances, parts: np.ndarray) -> np.ndarray:
    """Of all ways to exchange left and right of some of these parts the one with the best bones."""
    choices = [parts & np.array(bits) for bits in product((False, True), repeat=len(PARTS))]
    unique = list({tuple(choice): choice for choice in choices}.values())
    return min(unique, key=lambda choice: _badness(distances, with_sides(range(N_JOINTS), choice)))


def _badness(distances: Distances, index: Sequence[int]) -> float:
    return fit(distances, {name: index[place] for place, name in enumerate(_OWN.joints)}).badness


def _no_body(patient: Patient, misfit: float) -> Finding:
    evidence = f"bones miss people's lengths by {misfit:.0%}, in every known order by more than {_FITS:.0%}"
    standardised = not_positions(patient, evidence)
    if standardised is not None:
        return Finding((standardised,), patient, hopeless=True)
    remedy = "Check that joints are positions in space, and their order against prbench.skeleton.Joint."
    found = Diagnosis(
        "joint-order", True, evidence, "an order or a skeleton that is not known, or no positions", remedy
    )
    return Finding((found,), patient, hopeless=True)
