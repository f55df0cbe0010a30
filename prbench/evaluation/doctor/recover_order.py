"""Put joints of an unknown order into place: the assignment whose bones come nearest to people's."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product

import numpy as np

from prbench.evaluation.doctor.anatomy import PARTS
from prbench.evaluation.doctor.bones import BONE_ENDS, BONE_LENGTHS, Distances
from prbench.randomness import named_generator
from prbench.representation.clips import MIRRORED_JOINTS
from prbench.skeleton import N_JOINTS, Joint

_STARTS = 900
_GOOD = 0.16  # misfit that shuffled joints do not reach by chance
_PART_OF = np.array([PARTS.index(joint.name.lower().split("_")[-1]) if "_" in joint.name else -1 for joint in Joint])
_CHOICES = np.array([[part >= 0 and bits[part] for part in _PART_OF] for bits in product((False, True), repeat=8)])
"""Which joints take their mirror image's place, one row a way to exchange parts."""
_SIZES = (1.65, 1.45, 1.25)  # metres between the joints of a pose that lie farthest apart: standing, working, sitting
_ANKLES_AND_FEET = [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, Joint.LEFT_FOOT, Joint.RIGHT_FOOT]
_FEET_AND_ANKLES = _ANKLES_AND_FEET[2:] + _ANKLES_AND_FEET[:2]
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
        index, value = _descended(generator.permutation(N_JOINTS), cost)
        if value < lowest + 0.06:  # near enough that exchanging whole limbs may help
            index, value = _sides_exchanged(index, cost)
        confirmed += abs(value - lowest) < 1e-9
        if value < lowest - 1e-9:
            best, lowest, confirmed = index, value, 0
        if lowest < _GOOD and confirmed == 3:
            break
    return None if best is None or lowest > _GOOD else [int(joint) for joint in best]


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
    """The best of all ways to exchange left and right of single parts, such as both knees."""
    other_feet = order.copy()
    other_feet[_ANKLES_AND_FEET] = order[_FEET_AND_ANKLES]  # a shin is as long as from the knee to the toes
    exchanged = np.concatenate([np.where(_CHOICES, each[list(MIRRORED_JOINTS)], each) for each in (order, other_feet)])
    return _descended(exchanged[int(cost(exchanged).argmin())], cost)
