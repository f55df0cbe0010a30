"""The motions under examination, and what one fault hands to the next."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prbench.evaluation.doctor.types import Diagnosis, Expected


@dataclass(frozen=True, eq=False)
class Patient:
    """Motions, freed from the faults that were found so far."""

    motions: tuple[np.ndarray, ...]
    """Each (frames, joints, 3) float64, once the form is known."""
    expected: tuple[Expected, ...]
    """One a motion."""
    fps: float

    def moved(self, change: Callable[[np.ndarray], np.ndarray]) -> Patient:
        """The same with a change to each motion."""
        return dataclasses.replace(self, motions=tuple(change(motion) for motion in self.motions))

    def __len__(self) -> int:
        return len(self.motions)


@dataclass(frozen=True, eq=False)
class Finding:
    """What one examination found."""

    diagnoses: tuple[Diagnosis, ...]
    patient: Patient
    """With the fault undone, so that it leads to no second diagnosis."""
    hopeless: bool = False
    """The fault cannot be undone and hides everything behind it."""


Examination = Callable[[Patient], Finding]


def healthy(patient: Patient) -> Finding:
    """Nothing found."""
    return Finding((), patient)
