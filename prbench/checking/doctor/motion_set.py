"""The motions under examination, what is known beside them, and measures of bodies that no fault of axes changes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import CHAINS, PARENTS, Joint
from prbench.harness.methods.motions import spread_poses
from prbench.representation import REST_OFFSETS

AT_RATE = (
    "Resample to the asked rate (prbench.representation.converters.at_rate), or let the method declare native_fps: an"
    " attribute of an adapter, a key in the hello of a program."
)
AT_TIMES = "Resample on the frames' own times: prbench.representation.converters.at_times."


@dataclass(frozen=True)
class Diagnosis:
    """One thing that is wrong with motions, or may be."""

    kind: str
    """``unit``, ``up-axis``, ``facing`` …: docs/doctor.md lists them all."""
    certain: bool
    """True if the motions are wrong for sure, False if they are only suspicious."""
    evidence: str
    """The measured numbers, in a sentence."""
    cause: str
    """The most frequent reason for such numbers."""
    remedy: str
    """The change to make, with the converter where there is one."""


@dataclass(frozen=True, eq=False)
class Expected:
    """Expectations about one motion; canonical frame, metres. None means unknown and is not examined."""

    initial_joints: Float[np.ndarray, "22 3"] | None = None
    """The frame that the motion should begin with."""
    previous_joints: Float[np.ndarray, "22 3"] | None = None
    """The frame before that one."""
    goal_joints: Float[np.ndarray, "22 3"] | None = None
    """The pose that the motion should end in."""
    goal_location: Float[np.ndarray, " 3"] | None = None
    """The place that a wrist should reach."""
    n_frames: int | None = None
    """Number of frames that were asked for."""
    fps: float | None = None
    """Frames a second that were asked for."""
    recorded: Float[np.ndarray, "frames 22 3"] | None = None
    """The recorded motion of the same sequence, where the table may be read."""


NOTHING_KNOWN = Expected()


@dataclass(frozen=True, eq=False)
class MotionSet:
    """Motions, freed from the faults that were found so far."""

    motions: tuple[np.ndarray, ...]
    """Each (frames, joints, 3) float64, once the shape is known."""
    expected: tuple[Expected, ...]
    """One expectation for each motion."""
    fps: float
    pinned: bool = False
    """True if a fault keeps the pelvis in place, so that nothing can be said about place and floor."""

    def __len__(self) -> int:
        return len(self.motions)

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> MotionSet:
        """Return the set with each motion changed."""
        return dataclasses.replace(self, motions=tuple(change(motion) for motion in self.motions))

    def with_motions(self, motions: Sequence[np.ndarray]) -> MotionSet:
        """Return the set with other motions in their places."""
        return dataclasses.replace(self, motions=tuple(motions))

    def only(self, rows: Sequence[int]) -> MotionSet:
        """Return the set of some rows."""
        return dataclasses.replace(
            self, motions=tuple(self.motions[row] for row in rows), expected=tuple(self.expected[row] for row in rows)
        )

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

    def first_poses(self) -> np.ndarray:
        """Return the first pose of every motion, (motions, joints, 3)."""
        return np.stack([motion[0] for motion in self.motions])


@dataclass(frozen=True, eq=False)
class Finding:
    """The result of one examination."""

    diagnoses: tuple[Diagnosis, ...]
    motion_set: MotionSet
    """The motions with the fault undone, so that it leads to no second diagnosis."""
    unreadable: bool = False
    """True if the fault cannot be undone and hides everything that would be looked at later."""


Examination = Callable[[MotionSet], Finding]


def no_finding(motion_set: MotionSet) -> Finding:
    """Return the finding of an examination that found no fault."""
    return Finding((), motion_set)


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
    columns = [np.interp(places, frames, column) for column in flat.T]
    return np.stack(columns, axis=1).reshape(-1, *poses.shape[1:])


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


_LEG = ("hip", "knee", "ankle", "foot")
_ARM = ("collar", "shoulder", "elbow", "wrist")
_TRUNK = ("spine1", "spine2", "spine3")
_TOP = ("neck", "head")
_FOREIGN = (
    "Write its map for prbench.representation.converters.JointMap, which turns joints of other skeletons into the 22."
)


@dataclass(frozen=True)
class Order:
    """An order of joints."""

    name: str
    joints: tuple[str, ...]
    """In the order of the file; a joint that the 22 do not have has a name of its own."""
    remedy: str = ""
    """Instead of the index that puts the 22 joints into place."""

    def places(self) -> dict[str, int]:
        """Map the name of each joint to its place."""
        return {joint: place for place, joint in enumerate(self.joints)}

    @property
    def holds_all(self) -> bool:
        """True if it holds all 22 joints."""
        return set(_NAMES) <= set(self.joints)

    def index(self) -> tuple[int, ...]:
        """``joints[:, index]`` stands in HumanML3D's order."""
        places = self.places()
        return tuple(places[name] for name in _NAMES)


def _unique(joints: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(joints))


def _depth_first_orders() -> tuple[Order, ...]:
    orders = []
    for first, second in (("left", "right"), ("right", "left")):
        for trunk_first in (False, True):
            for arms_before_head in (False, True):
                start = "trunk" if trunk_first else "legs"
                top = "arms before the head" if arms_before_head else "head before the arms"
                if (first, trunk_first, arms_before_head) == ("right", False, False):
                    continue  # the chain order of HumanML3D
                name = f"depth-first order, as in BVH files ({start} first, {first} side first, {top})"
                legs = _side(first, _LEG) + _side(second, _LEG)
                arms = _side(first, _ARM) + _side(second, _ARM)
                upper = _TRUNK + (arms + _TOP if arms_before_head else _TOP + arms)
                orders.append(Order(name, ("pelvis", *(upper + legs if trunk_first else legs + upper))))
    return tuple(orders)


def _side(side: str, parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{side}_{part}" for part in parts)


_CHAIN_ORDER = Order(
    "kinematic chain order of HumanML3D", _unique(tuple(_NAMES[joint] for chain in CHAINS for joint in chain))
)
ORDERS_OF_22: tuple[Order, ...] = (
    _CHAIN_ORDER,
    *_depth_first_orders(),
    Order("alphabetical order (left_ankle, left_collar …)", tuple(sorted(_NAMES))),
    Order("reversed order", _NAMES[::-1]),
    Order(
        "all left joints, then all right ones, behind those of the middle",
        tuple(sorted(_NAMES, key=lambda name: ("left" in name) + 2 * ("right" in name))),
    ),
    Order("pelvis at the end", (*_NAMES[1:], "pelvis")),
)
"""Full orders of the 22 joints other than HumanML3D's own."""
OTHER_ORDERS: tuple[Order, ...] = (
    Order(
        "OpenPose COCO (18 joints)",
        ("nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
         "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
         "right_ear", "left_ear"),
        _FOREIGN,
    ),
    Order(
        "KIT motion-language (21 joints)",
        ("pelvis", "spine1", "spine3", "neck", "head", "left_shoulder", "left_elbow", "left_wrist", "right_shoulder",
         "right_elbow", "right_wrist", "left_hip", "left_knee", "left_ankle", "left_heel", "left_foot", "right_hip",
         "right_knee", "right_ankle", "right_heel", "right_foot"),
        _FOREIGN,
    ),
    Order("the 22 joints without the pelvis (21 joints)", _NAMES[1:], "Put the pelvis back at place 0."),
)  # fmt: skip
"""Orders with another number of joints that are not among ``prbench.representation.converters.JOINT_MAPS``."""
