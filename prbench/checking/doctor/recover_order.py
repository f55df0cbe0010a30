"""Put joints of an unknown order into place: the assignment whose bones come nearest to people's."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product

import numpy as np

from prbench.checking.doctor.anatomy import PARTS
from prbench.checking.doctor.bones import BONE_ENDS, BONE_LENGTHS, Distances
from prbench.randomness import named_generator
from prbench.representation import REST_OFFSETS
from prbench.representation.clips import MIRRORED_JOINTS
from prbench.skeleton import N_JOINTS, PARENTS, Joint

_STARTS = 120
_LOOSENESS = 0.5  # of the last guess: how much chance may change a joint's likeness
_GOOD = 0.16  # misfit that shuffled joints do not reach by chance
_PART_OF = np.array([PARTS.index(joint.name.lower().split("_")[-1]) if "_" in joint.name else -1 for joint in Joint])
_CHOICES = np.array([[part >= 0 and bits[part] for part in _PART_OF] for bits in product((False, True), repeat=8)])
"""Which joints take their mirror image's place, one row a way to exchange parts."""
_SIZES = (1.65, 1.45, 1.25)  # metres between the joints of a pose that lie farthest apart: standing, working, sitting
_REST = np.zeros((N_JOINTS, 3))
for _joint in range(1, N_JOINTS):
    _REST[_joint] = _REST[PARENTS[_joint]] + REST_OFFSETS[_joint]
_STANDING = np.linalg.norm(_REST[:, None] - _REST, axis=-1)
"""Distances between the joints of a body that stands with its arms hanging."""
_SWAPS = np.array(list(combinations(range(N_JOINTS), 2)))


def recovered_order(distances: Distances) -> list[int] | None:
    """The index that puts 22 joints into HumanML3D's order, or None if none gives a body.

    Exchanges pairs of joints as long as bones get better, from many starts. Distances alone do not tell left from
    right.
    """
    best, lowest, confirmed = None, np.inf, 0
    generator = named_generator("doctor", "joint order")
    for start in range(_STARTS):
        cost = _cost(distances, distances.median.max() / _SIZES[start % len(_SIZES)])
        index, value = _descended(_guess(distances, _LOOSENESS * (start / _STARTS), generator), cost)
        if value < lowest + 0.06:  # near enough that exchanging whole limbs may help
            index, value = _sides_exchanged(index, cost)
        confirmed += abs(value - lowest) < 1e-9
        if value < lowest - 1e-9:
            best, lowest, confirmed = index, value, 0
        if lowest < _GOOD and confirmed == 3:
            break
    if best is None or lowest > _GOOD:
        return None
    candidates = _relatives(best)
    return [int(joint) for joint in candidates[int(_misfit_at_own_size(distances, candidates).argmin())]]


def _misfit_at_own_size(distances: Distances, orders: np.ndarray) -> np.ndarray:
    """The cost of orders whose bodies may have any size."""
    one, other = BONE_ENDS
    ends = orders[:, one], orders[:, other]
    lengths = distances.median[ends]
    people = BONE_LENGTHS * (lengths.sum(axis=1, keepdims=True) / BONE_LENGTHS.sum())
    return (np.abs(lengths - people) + distances.spread[ends]).sum(axis=1) / people.sum(axis=1)


def _guess(distances: Distances, looseness: float, generator: np.random.Generator) -> np.ndarray:
    """Joints assigned one after another by how alike their distances to all others are to those in a standing body."""
    here, there = _profiles(distances.median), _profiles(_STANDING)
    unlike = np.abs(here[None] - there[:, None]).mean(axis=-1)
    unlike += looseness * unlike.mean() * generator.standard_normal(unlike.shape)
    order = np.empty(N_JOINTS, dtype=int)
    for _ in range(N_JOINTS):
        place, joint = np.unravel_index(unlike.argmin(), unlike.shape)
        order[place] = joint
        unlike[place], unlike[:, joint] = np.inf, np.inf
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
        order, value = neighbours[best], float(values[best])


def _sides_exchanged(order: np.ndarray, cost: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, float]:
    """The best of an order's relatives, improved as far as exchanging single joints goes."""
    relatives = _relatives(order)
    return _descended(relatives[int(cost(relatives).argmin())], cost)


def _relatives(order: np.ndarray) -> np.ndarray:
    """All orders that exchange left and right of single parts, such as both knees, or an ankle and its foot."""
    variants = [order]
    for ankle, foot in ((Joint.LEFT_ANKLE, Joint.LEFT_FOOT), (Joint.RIGHT_ANKLE, Joint.RIGHT_FOOT)):
        for variant in tuple(variants):  # a shin is about as long as from the knee to the toes
            other = variant.copy()
            other[[ankle, foot]] = variant[[foot, ankle]]
            variants.append(other)
    return np.concatenate([np.where(_CHOICES, each[list(MIRRORED_JOINTS)], each) for each in variants])
