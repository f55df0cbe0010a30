"""Measures directions and bone lengths of bodies, whatever axes and names they were given.

Poses are (poses, 22, 3) in any unit and any world, right-handed or not; every function turns and moves along with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.geometry.skeleton import PARENTS, Joint
from prbench.representation import REST_OFFSETS

_NEGLIGIBLE = 1e-9
_LENGTHS = np.linalg.norm(REST_OFFSETS, axis=1)
_EXTRA = (
    ("left_hip", "right_hip", 0.16),
    ("left_shoulder", "right_shoulder", 0.36),
    ("left_hip", "left_shoulder", 0.52),
    ("right_hip", "right_shoulder", 0.52),
)
"""Across the trunk: they tell which side a whole limb belongs to, and hold for skeletons without a spine."""
_LEFTS = [joint for joint in Joint if joint.name.startswith("LEFT")]
_RIGHTS = [joint for joint in Joint if joint.name.startswith("RIGHT")]
PARTS = tuple(joint.name.removeprefix("LEFT_").lower() for joint in _LEFTS)
"""Names of the parts that exist on both sides, from the hips to the wrists."""
_NAMES = tuple(joint.name.lower() for joint in Joint)
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
    """The bones of joints in one order, compared with those of people."""

    misfit: float
    """Mean difference between the lengths of bones and people's, as a share of the mean length; 0 is perfect."""
    stretch: float
    """Mean standard deviation of a bone's length over time, as a share of the mean length."""

    @property
    def badness(self) -> float:
        """The number by which orders are compared."""
        return self.misfit + self.stretch


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
        every = []
        spreads = []
        for motion in motions:
            some = motion[np.linspace(0, len(motion) - 1, min(len(motion), 24)).astype(int)]
            apart = np.linalg.norm(some[:, :, None] - some[:, None], axis=-1)
            every.append(apart)
            spreads.append(apart.std(axis=0))
        return cls(np.median(np.concatenate(every), axis=0), np.mean(spreads, axis=0))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors to length one; those without a length stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > _NEGLIGIBLE, vectors / np.maximum(length, _NEGLIGIBLE), 0.0)


def body_up(poses: np.ndarray) -> np.ndarray:
    """Return the direction from the ankles to the head, (poses, 3)."""
    return unit(poses[:, Joint.HEAD] - _middle(poses, Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE))


def left_of_hips(poses: np.ndarray) -> np.ndarray:
    """Return the direction from the right hip to the left one as they are named, (poses, 3)."""
    return unit(poses[:, Joint.LEFT_HIP] - poses[:, Joint.RIGHT_HIP])


def left_of_shoulders(poses: np.ndarray) -> np.ndarray:
    """Return the direction from the right shoulder to the left one as they are named, (poses, 3)."""
    return unit(poses[:, Joint.LEFT_SHOULDER] - poses[:, Joint.RIGHT_SHOULDER])


def front(poses: np.ndarray) -> np.ndarray:
    """Return where toes point, knees bend and the head lies before the neck; elbows bend backwards; (poses, 3).

    Names of left and right do not matter, nor does the handedness of the world.
    """
    toes = _sum(poses, Joint.LEFT_FOOT, Joint.RIGHT_FOOT) - _sum(poses, Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE)
    knees = _bend(poses, Joint.LEFT_HIP, Joint.LEFT_KNEE, Joint.LEFT_ANKLE) + _bend(
        poses, Joint.RIGHT_HIP, Joint.RIGHT_KNEE, Joint.RIGHT_ANKLE
    )
    elbows = _bend(poses, Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST) + _bend(
        poses, Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST
    )
    head = poses[:, Joint.HEAD] - poses[:, Joint.NECK]
    # Toes tell most reliably; elbows bend backwards and are often straight, so they count half.
    cue = 2 * toes + knees + head - elbows / 2
    up = body_up(poses)
    return unit(cue - (cue * up).sum(axis=-1, keepdims=True) * up)


def sideways_agreement(poses: np.ndarray) -> np.ndarray:
    """Return for each part how often its left lies on the side of the left hip: 1 always, -1 never; (8 parts,)."""
    hips = left_of_hips(poses)
    sideways = ((poses[:, _LEFTS] - poses[:, _RIGHTS]) * hips[:, None]).sum(axis=-1)
    return sideways.mean(axis=0) / np.maximum(np.abs(sideways).mean(axis=0), _NEGLIGIBLE)


def sidedness(poses: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Return +1 where ``left`` lies to the left of the front, -1 where it lies to the right; the head is up."""
    return (np.cross(left, body_up(poses)) * front(poses)).sum(axis=-1)


def with_sides(index: Sequence[int], exchanged: np.ndarray) -> list[int]:
    """Exchange left and right in an index of joints, for some of :data:`PARTS`."""
    result = list(index)
    for left, right, swap in zip(_LEFTS, _RIGHTS, exchanged, strict=True):
        if swap:
            result[left], result[right] = result[right], result[left]
    return result


def _middle(poses: np.ndarray, one: int, other: int) -> np.ndarray:
    return _sum(poses, one, other) / 2


def _sum(poses: np.ndarray, one: int, other: int) -> np.ndarray:
    return poses[:, one] + poses[:, other]


def _bend(poses: np.ndarray, upper: int, middle: int, lower: int) -> np.ndarray:
    """Return the vector from the middle between the ends of a limb to its middle joint."""
    return poses[:, middle] - _middle(poses, upper, lower)


def fit(distances: Distances, places: dict[str, int]) -> Fit:
    """Compare the bones that an order names with people's."""
    named = [(places[one], places[other], length) for one, other, length in _BONES if one in places and other in places]
    one, other, typical = (np.array(column) for column in zip(*named, strict=True))
    lengths = distances.median[one, other]
    scale = lengths.sum() / typical.sum()
    # The scale is fitted away: units are judged elsewhere.
    people = scale * typical
    return Fit(
        float(np.abs(lengths - people).sum() / people.sum()),
        float(distances.spread[one, other].sum() / people.sum()),
    )
