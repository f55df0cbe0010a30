"""What the doctor says about motions, and what it may be told beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


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
