"""What one picture, film or page shows of one sequence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from prbench.skeleton import Joint

RECORDED = "ground truth"
"""Label of the recorded motion."""


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """One motion of a sequence: the recorded one, or what a method made of it."""

    label: str
    colour: str
    """``#rrggbb``."""
    joints: Float[np.ndarray, "n 22 3"]
    """Canonical frame, metres."""
    scores: Mapping[str, float] = field(default_factory=dict)
    """By metric id; rates are 0 or 1. Empty if the motion was not scored."""


@dataclass(frozen=True, eq=False)
class Gaze:
    """Recorded gaze: one ray a frame, canonical frame, metres."""

    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    """Unit vectors."""
    valid: Bool[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Goal:
    """Where the object is, or will be; canonical frame, metres."""

    location: Float[np.ndarray, "3"]
    box_corners: Float[np.ndarray, "8 3"]
    """In the order of :data:`BOX_EDGES`."""


BOX_EDGES: tuple[tuple[int, int], ...] = (
    (0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7), (6, 7),
)  # fmt: skip
"""Corners of a box that an edge joins, where a corner's number has a bit for each axis."""


@dataclass(frozen=True)
class Thresholds:
    """What the protocol asks of priming and reaching, drawn beside the measured values."""

    prime_distance: float
    """Metres between head ray and goal."""
    prime_window: float
    """Seconds on both sides of the prime time."""
    reach_distance: float
    """Metres between wrist and goal."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One sequence with its motions."""

    sequence_id: str
    dataset: str
    title: str
    """What is done with which hand, for people."""
    action: str
    """``pick`` or ``put``."""
    fps: float
    n_frames: int
    prime_time: float
    """Seconds after the first frame; the event is the last frame."""
    head_tilt_deg: float
    """See :func:`prbench.skeleton.head_forward`."""
    motions: tuple[ShownMotion, ...]
    """The recorded motion first, unless it is withheld."""
    thresholds: Thresholds
    goal: Goal | None = None
    """None where the licence keeps it, or nobody knows where it is."""
    gaze: Gaze | None = None
    """None where the licence keeps it, or there is none."""
    notice: str = ""
    """What the dataset's terms ask a view of it to say."""
    surroundings: Float[np.ndarray, "k 3"] | None = None
    """Points on what stood around when the event came, canonical frame, metres. None unless asked for, and where the
    licence keeps it."""

    @property
    def shows_recorded(self) -> bool:
        """Whether the first motion is the recorded one."""
        return self.motions[0].label == RECORDED

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Of the frames, seconds after the first."""
        return np.arange(self.n_frames) / self.fps

    @property
    def event_time(self) -> float:
        """Seconds after the first frame."""
        return (self.n_frames - 1) / self.fps

    @property
    def prime_frame(self) -> int:
        """The frame nearest to the prime time."""
        return int(np.clip(round(self.prime_time * self.fps), 0, self.n_frames - 1))

    @property
    def picture_axis(self) -> Float[np.ndarray, "3"]:
        """Horizontal unit vector that points to the right in side views: towards the goal when the event comes.

        Without a goal, the way that the first motion's pelvis went; the reach is then seen from the side all the same.
        """
        pelvis = self.motions[0].joints[:, Joint.PELVIS]
        towards = (pelvis[-1] - pelvis[0]) if self.goal is None else (self.goal.location - pelvis[-1])
        towards = towards * [1.0, 0.0, 1.0]
        length = float(np.linalg.norm(towards))
        return towards / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
