"""The motions under examination, what is known beside them, and what an examination says about them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.methods.body_size import spread_poses


@dataclass(frozen=True)
class Diagnosis:
    """One thing that is wrong with motions, or may be."""

    kind: str
    """``unit``, ``up-axis``, ``facing`` …: docs/doctor.md lists them all."""
    certain: bool
    """Wrong for sure; otherwise only suspicious."""
    evidence: str
    """The numbers."""
    cause: str
    """What most often leads to such numbers."""
    remedy: str
    """What to change, naming the converter where there is one."""


@dataclass(frozen=True, eq=False)
class Expected:
    """What is known beside one motion; canonical frame, metres. Whatever is None is not looked at."""

    initial_joints: Float[np.ndarray, "22 3"] | None = None
    """The frame that the motion should begin with."""
    previous_joints: Float[np.ndarray, "22 3"] | None = None
    """The frame before that one."""
    goal_joints: Float[np.ndarray, "22 3"] | None = None
    """The pose that the motion should end in."""
    goal_location: Float[np.ndarray, " 3"] | None = None
    """The place that a wrist should reach."""
    n_frames: int | None = None
    """How many frames were asked for."""
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
    """One a motion."""
    fps: float
    pinned: bool = False
    """The pelvis does not move by fault, so that nothing can be said about place and floor."""

    def __len__(self) -> int:
        return len(self.motions)

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> MotionSet:
        """The same with a change to each motion."""
        return dataclasses.replace(self, motions=tuple(change(motion) for motion in self.motions))

    def with_motions(self, motions: Sequence[np.ndarray]) -> MotionSet:
        """The same with other motions in their places."""
        return dataclasses.replace(self, motions=tuple(motions))

    def only(self, rows: Sequence[int]) -> MotionSet:
        """The same without the other motions."""
        return dataclasses.replace(
            self, motions=tuple(self.motions[row] for row in rows), expected=tuple(self.expected[row] for row in rows)
        )

    def without_lengths(self) -> MotionSet:
        """The same, with nothing expected of lengths: a fault that was found has changed them."""
        expected = tuple(dataclasses.replace(each, n_frames=None) for each in self.expected)
        return dataclasses.replace(self, expected=expected)

    @property
    def motionless(self) -> bool:
        """Whether no motion moves, as those of a baseline that holds one pose."""
        return all(float(np.ptp(motion, axis=0).max()) < 1e-6 for motion in self.motions)

    def in_words(self, count: int) -> str:
        """Say how many of the motions ``count`` is."""
        if len(self) == 1:
            return "the motion"
        return f"all {count} motions" if count == len(self) else f"{count} of {len(self)} motions"

    def poses(self) -> np.ndarray:
        """Some poses of every motion, evenly spread, (poses, joints, 3)."""
        return np.concatenate([spread_poses(motion) for motion in self.motions])

    def first_poses(self) -> np.ndarray:
        """The first pose of every motion, (motions, joints, 3)."""
        return np.stack([motion[0] for motion in self.motions])


@dataclass(frozen=True, eq=False)
class Finding:
    """What one examination found."""

    diagnoses: tuple[Diagnosis, ...]
    motion_set: MotionSet
    """With the fault undone, so that it leads to no second diagnosis."""
    unreadable: bool = False
    """The fault cannot be undone and hides everything that would be looked at later."""


Examination = Callable[[MotionSet], Finding]


def no_finding(motion_set: MotionSet) -> Finding:
    """Nothing found."""
    return Finding((), motion_set)


AT_RATE = (
    "Resample to the asked rate (prbench.representation.converters.at_rate), or let the method declare native_fps: an"
    " attribute of an adapter, a key in the hello of a program."
)
AT_TIMES = "Resample on the frames' own times: prbench.representation.converters.at_times."
