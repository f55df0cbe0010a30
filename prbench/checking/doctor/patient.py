"""The motions under examination, and what one examination hands to the next."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from prbench.checking.doctor.types import Diagnosis, Expected
from prbench.methods.body_size import spread_poses


@dataclass(frozen=True, eq=False)
class Patient:
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

    def changed(self, change: Callable[[np.ndarray], np.ndarray]) -> Patient:
        """The same with a change to each motion."""
        return dataclasses.replace(self, motions=tuple(change(motion) for motion in self.motions))

    def with_motions(self, motions: Sequence[np.ndarray]) -> Patient:
        """The same with other motions in their places."""
        return dataclasses.replace(self, motions=tuple(motions))

    def only(self, rows: Sequence[int]) -> Patient:
        """The same without the other motions."""
        return dataclasses.replace(
            self, motions=tuple(self.motions[row] for row in rows), expected=tuple(self.expected[row] for row in rows)
        )

    def without_lengths(self) -> Patient:
        """The same, with nothing expected of lengths: a fault that was found has changed them."""
        expected = tuple(dataclasses.replace(each, n_frames=None) for each in self.expected)
        return dataclasses.replace(self, expected=expected)

    @property
    def motionless(self) -> bool:
        """Whether no motion moves, as those of a baseline that holds one pose."""
        return all(float(np.ptp(motion, axis=0).max()) < 1e-6 for motion in self.motions)

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
    patient: Patient
    """With the fault undone, so that it leads to no second diagnosis."""
    hopeless: bool = False
    """The fault cannot be undone and hides everything that would be looked at later."""


Examination = Callable[[Patient], Finding]


def healthy(patient: Patient) -> Finding:
    """Nothing found."""
    return Finding((), patient)


def of_motions(count: int, patient: Patient) -> str:
    """How many motions, in words."""
    if len(patient) == 1:
        return "the motion"
    return f"all {count} motions" if count == len(patient) else f"{count} of {len(patient)} motions"
