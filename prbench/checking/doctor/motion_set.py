"""The motions under examination, what is known beside them, and what an examination says about them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.harness.methods.coordinates import spread_poses

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
