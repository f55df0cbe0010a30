"""The motions under examination, what is known beside them, and measures of bodies that no fault of axes changes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.diagnosis import Diagnosis
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.representation import REST_OFFSETS

_POSES_PER_MOTION = 24


@dataclass(frozen=True, eq=False)
class Expected:
    """Expectations about one motion; canonical frame, metres. None means unknown and is not examined.

    Attributes:
        initial_joints: The frame that the motion should begin with.
        previous_joints: The frame before that one.
        n_frames: Number of frames that were asked for.
        fps: Frames a second that were asked for.
    """

    initial_joints: Float[np.ndarray, "22 3"] | None = None
    previous_joints: Float[np.ndarray, "22 3"] | None = None
    n_frames: int | None = None
    fps: float | None = None

    @classmethod
    def of_each(cls, asked: Any) -> list[Expected]:
        """Return what a batch of conditions, or a file of them, asks of each of its motions."""
        nothing = [None] * len(asked)
        poses = (nothing if each is None else each for each in (asked.initial_joints, asked.previous_joints))
        rates = np.broadcast_to(asked.fps, len(asked)).tolist()
        return [cls(*each) for each in zip(*poses, asked.n_frames.tolist(), rates, strict=True)]


NOTHING_KNOWN = Expected()


@dataclass(frozen=True, eq=False)
class MotionSet:
    """Motions, freed from the faults that were found so far.

    Attributes:
        motions: Each (frames, joints, 3) float64, once the shape is known.
        expected: One expectation for each motion.
        pinned: True if a fault keeps the pelvis in place, so that nothing can be said about place and floor.
    """

    motions: tuple[np.ndarray, ...]
    expected: tuple[Expected, ...]
    fps: float
    pinned: bool = False

    def __len__(self) -> int:
        return len(self.motions)

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> MotionSet:
        """Return the set with each motion changed."""
        return self.with_motions([change(motion) for motion in self.motions])

    def with_motions(self, motions: Sequence[np.ndarray]) -> MotionSet:
        """Return the set with other motions in their places."""
        return dataclasses.replace(self, motions=tuple(motions))

    def only(self, rows: Sequence[int]) -> MotionSet:
        """Return the set of some rows."""
        expected = tuple(self.expected[row] for row in rows)
        return dataclasses.replace(self, motions=tuple(self.motions[row] for row in rows), expected=expected)

    def without_lengths(self) -> MotionSet:
        """Return the set with nothing expected of lengths, because a fault has changed them."""
        expected = tuple(dataclasses.replace(each, n_frames=None) for each in self.expected)
        return dataclasses.replace(self, expected=expected)

    @property
    def motionless(self) -> bool:
        """True if no motion moves, as those of a baseline that holds one pose."""
        return all(float(np.ptp(motion, axis=0).max()) < 1e-6 for motion in self.motions)

    def in_words(self, count: int) -> str:
        """Say how many of the motions ``count`` is."""
        if len(self) == 1:
            return "the motion"
        return f"all {count} motions" if count == len(self) else f"{count} of {len(self)} motions"

    def poses(self) -> np.ndarray:
        """Return evenly spread poses of every motion, (poses, joints, 3)."""
        return np.concatenate([spread_poses(motion) for motion in self.motions])

    @cached_property
    def distances(self) -> tuple[np.ndarray, np.ndarray]:
        """The distances between all pairs of joints; see :func:`joint_distances`."""
        return joint_distances(self.motions)

    def first_poses(self) -> np.ndarray:
        """Return the first pose of every motion, (motions, joints, 3)."""
        return np.stack([motion[0] for motion in self.motions])


@dataclass(frozen=True, eq=False)
class Finding:
    """What one examination found; an examination that found nothing returns None.

    Attributes:
        motion_set: The motions with the fault undone, so that it leads to no second diagnosis.
        unreadable: True if the fault cannot be undone and hides everything that would be looked at later.
    """

    diagnoses: tuple[Diagnosis, ...]
    motion_set: MotionSet
    unreadable: bool = False


def spread_poses(motion: Float[np.ndarray, "frames joints 3"]) -> Float[np.ndarray, "poses joints 3"]:
    """Return at most 24 poses of a motion, evenly spread over its frames."""
    return motion[np.linspace(0, len(motion) - 1, min(len(motion), _POSES_PER_MOTION)).astype(int)]


def on_straight_lines(poses: np.ndarray, frames: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Interpolate poses linearly; the first and the last pose are held beyond both ends.

    Args:
        poses: Known poses, (known, joints, 3).
        frames: Their frame numbers, increasing, (known,).
        places: Wanted frame numbers, may be fractional, (wanted,).

    Returns:
        Poses at these places, (wanted, joints, 3).
    """
    flat = poses.reshape(len(poses), -1)
    return np.stack([np.interp(places, frames, column) for column in flat.T], axis=1).reshape(-1, *poses.shape[1:])


def joint_distances(motions: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Measure the distances between all pairs of joints: no axis, no handedness and no origin is in them.

    Returns:
        Median over poses, and standard deviation within a motion averaged over motions; (joints, joints) each.
    """
    every = []
    for motion in motions:
        some = spread_poses(motion)
        every.append(np.linalg.norm(some[:, :, None] - some[:, None], axis=-1))
    return np.median(np.concatenate(every), axis=0), np.mean([apart.std(axis=0) for apart in every], axis=0)


_NAMES = tuple(joint.name.lower() for joint in Joint)
# Beside the bones some distances across the trunk, which tell the side that a whole limb belongs to, metres.
_ACROSS = (
    (Joint.LEFT_HIP, Joint.RIGHT_HIP, 0.16),
    (Joint.LEFT_SHOULDER, Joint.RIGHT_SHOULDER, 0.36),
    (Joint.LEFT_HIP, Joint.LEFT_SHOULDER, 0.52),
    (Joint.RIGHT_HIP, Joint.RIGHT_SHOULDER, 0.52),
)
_ENDS = np.array([(PARENTS[joint], joint) for joint in range(1, N_JOINTS)] + [row[:2] for row in _ACROSS])
_PEOPLES = np.concatenate([np.linalg.norm(REST_OFFSETS[1:], axis=1), [row[2] for row in _ACROSS]])


def fit(distances: tuple[np.ndarray, np.ndarray], index: Sequence[int] = range(N_JOINTS)) -> tuple[float, float]:
    """Compare the bones of joints in some order with those of people; the size is fitted away.

    Args:
        distances: Median and spread that :func:`joint_distances` returns.
        index: ``joints[:, index]`` stands in HumanML3D's order.

    Returns:
        Mean difference from people's lengths and mean standard deviation over time, as shares of the mean length.
    """
    median, spread = distances
    one, other = np.asarray(index)[_ENDS].T
    lengths = median[one, other]
    people = _PEOPLES * (lengths.sum() / _PEOPLES.sum())
    return float(np.abs(lengths - people).sum() / people.sum()), float(spread[one, other].sum() / people.sum())


def unit(vectors: np.ndarray) -> np.ndarray:
    """Scale vectors to length one; those without a length stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-9, vectors / np.maximum(length, 1e-9), 0.0)


def body_up(poses: np.ndarray) -> np.ndarray:
    """Return the direction from the ankles to the head, (poses, 3)."""
    return unit(poses[:, Joint.HEAD] - poses[:, [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]].mean(axis=1))


def front(poses: np.ndarray) -> np.ndarray:
    """Return where toes point, knees bend and the head lies before the neck; elbows bend backwards; (poses, 3).

    Names of left and right do not matter, nor does the handedness of the world.
    """
    head = poses[:, Joint.HEAD] - poses[:, Joint.NECK]
    cue = np.zeros_like(head) + head
    for side in ("LEFT", "RIGHT"):
        parts = ("HIP", "KNEE", "ANKLE", "FOOT", "SHOULDER", "ELBOW", "WRIST")
        hip, knee, ankle, foot, shoulder, elbow, wrist = (poses[:, Joint[f"{side}_{part}"]] for part in parts)
        # Toes tell most reliably; elbows bend backwards and are often straight, so they count half.
        cue += 2 * (foot - ankle) + (knee - (hip + ankle) / 2) - (elbow - (shoulder + wrist) / 2) / 2
    up = body_up(poses)
    return unit(cue - (cue * up).sum(axis=-1, keepdims=True) * up)


def sidedness(poses: np.ndarray, part: str = "HIP") -> np.ndarray:
    """Return +1 where the left hip (or shoulder) lies to the left of the front, -1 to the right; the head is up."""
    left = unit(poses[:, Joint[f"LEFT_{part}"]] - poses[:, Joint[f"RIGHT_{part}"]])
    return (np.cross(left, body_up(poses)) * front(poses)).sum(axis=-1)


def _orders_of_22() -> dict[str, tuple[str, ...]]:
    orders = {}
    trunk = ("spine1", "spine2", "spine3")
    for sides in (("left", "right"), ("right", "left")):
        legs = tuple(f"{side}_{part}" for side in sides for part in ("hip", "knee", "ankle", "foot"))
        arms = tuple(f"{side}_{part}" for side in sides for part in ("collar", "shoulder", "elbow", "wrist"))
        for top, upper in (
            ("head before the arms", (*trunk, "neck", "head", *arms)),
            ("arms before the head", (*trunk, *arms, "neck", "head")),
        ):
            for start, rest in (("legs", legs + upper), ("trunk", upper + legs)):
                # With the right side first and the legs first it is the order of HumanML3D's kinematic chains.
                name = f"depth-first order, as in BVH files ({start} first, {sides[0]} side first, {top})"
                orders[name] = ("pelvis", *rest)
    orders["alphabetical order (left_ankle, left_collar …)"] = tuple(sorted(_NAMES))
    orders["reversed order"] = _NAMES[::-1]
    by_side = sorted(_NAMES, key=lambda name: ("left" in name) + 2 * ("right" in name))
    orders["all left joints, then all right ones, behind those of the middle"] = tuple(by_side)
    orders["pelvis at the end"] = (*_NAMES[1:], "pelvis")
    return orders


ORDERS_OF_22 = _orders_of_22()  # joints of full orders other than HumanML3D's own


def index_of(joints: Sequence[str]) -> list[int]:
    """Return the index that puts the 22 joints of an order into HumanML3D's: ``joints[:, index]``."""
    return [joints.index(name) for name in _NAMES]
