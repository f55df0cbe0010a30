"""How well joints in some order make a body: lengths of bones against those of people, whatever the scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.representation import REST_OFFSETS
from prbench.skeleton import PARENTS, Joint

_NAMES = tuple(joint.name.lower() for joint in Joint)
_LENGTHS = np.linalg.norm(REST_OFFSETS, axis=1)
_EXTRA = (
    ("left_hip", "right_hip", 0.16),
    ("left_shoulder", "right_shoulder", 0.36),
    ("left_hip", "left_shoulder", 0.52),
    ("right_hip", "right_shoulder", 0.52),
)
"""Across the trunk: they tell which side a whole limb belongs to, and hold for skeletons without a spine."""
_BONES = (
    *((_NAMES[PARENTS[joint]], _NAMES[joint], float(_LENGTHS[joint])) for joint in range(1, len(Joint))),
    *_EXTRA,
)
_PLACES = {name: place for place, name in enumerate(_NAMES)}
BONE_ENDS = (np.array([_PLACES[one] for one, _, _ in _BONES]), np.array([_PLACES[other] for _, other, _ in _BONES]))
"""Joints at both ends of what :func:`fit` measures, in HumanML3D's order."""
BONE_LENGTHS = np.array([length for _, _, length in _BONES])
"""People's, metres."""


@dataclass(frozen=True)
class Fit:
    """How joints in one order compare with a body."""

    misfit: float
    """Mean difference between the lengths of bones and people's, as a share of the mean length; 0 is perfect."""
    stretch: float
    """Mean standard deviation of a bone's length over time, as a share of the mean length."""

    @property
    def badness(self) -> float:
        """One number to compare orders by."""
        return self.misfit + self.stretch


def fit(distances: Distances, places: dict[str, int]) -> Fit:
    """Compare the bones that an order names with people's."""
    named = [(places[one], places[other], length) for one, other, length in _BONES if one in places and other in places]
    one, other, typical = (np.array(column) for column in zip(*named, strict=True))
    lengths = distances.median[one, other]
    scale = lengths.sum() / typical.sum()
    people = scale * typical
    return Fit(
        float(np.abs(lengths - people).sum() / people.sum()),
        float(distances.spread[one, other].sum() / people.sum()),
    )


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances between all pairs of joints: no axis, no handedness and no origin is in them."""

    median: np.ndarray
    """(joints, joints), over poses."""
    spread: np.ndarray
    """(joints, joints), standard deviation within a motion, averaged over motions."""

    @classmethod
    def of(cls, motions: tuple[np.ndarray, ...]) -> Distances:
        """Measure motions of one number of joints."""
        every, spreads = [], []
        for motion in motions:
            some = motion[np.linspace(0, len(motion) - 1, min(len(motion), 24)).astype(int)]
            apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
            every.append(apart)
            spreads.append(apart.std(axis=0))
        return cls(np.median(np.concatenate(every), axis=0), np.mean(spreads, axis=0))
