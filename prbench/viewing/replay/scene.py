"""The data that one picture, film or page shows of one sequence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import Joint
from prbench.protocol.manifests import MetricConstants
from prbench.viewing.figures import horizontal_direction

RECORDED = "ground truth"
"""Label of the recorded motion."""

Progress = Callable[[int, int, str], None]
"""Called with finished steps, all steps, and the sequence that was worked on last."""


@dataclass(frozen=True, eq=False)
class Gaze:
    """One ray a frame, canonical frame, metres."""

    origin: Float[np.ndarray, "n 3"]
    direction: Float[np.ndarray, "n 3"]
    """Unit vectors."""
    valid: Bool[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """One motion of a sequence: the recorded one, or what a method made of it."""

    label: str
    colour: str
    """``#rrggbb``."""
    joints: Float[np.ndarray, "n 22 3"]
    """Canonical frame, metres."""
    scores: Mapping[str, float] = field(default_factory=dict)
    """Maps metric ids to values; rates are 0 or 1. Empty if the motion was not scored."""
    gaze: Gaze | None = None
    """Recorded with the motion, or generated with it; None for a motion without eyes."""


@dataclass(frozen=True, eq=False)
class Goal:
    """Place of the object at the event; canonical frame, metres."""

    location: Float[np.ndarray, "3"]
    box_corners: Float[np.ndarray, "8 3"]
    """In the order that :data:`prbench.viewing.figures.BOX_EDGES` expects."""


@dataclass(frozen=True, eq=False)
class Scene:
    """One sequence with its motions."""

    sequence_id: str
    dataset: str
    title: str
    """Action, object, hand and split in words."""
    action: str
    """``pick`` or ``put``."""
    fps: float
    n_frames: int
    prime_time: float
    """Seconds after the first frame; the event is the last frame."""
    head_tilt_deg: float
    """See :func:`prbench.geometry.skeleton.head_forward`."""
    motions: tuple[ShownMotion, ...]
    """The recorded motion first, unless it is withheld."""
    thresholds: MetricConstants
    """The protocol's limits of priming and reaching, drawn beside the measured values."""
    goal: Goal | None = None
    """None where the recorded motion is withheld, and where the goal's place is unknown."""
    notice: str = ""
    """Sentence that the dataset's terms ask a view to show."""
    surroundings: Float[np.ndarray, "k 3"] | None = None
    """Points on the surroundings at the time of the event, canonical frame, metres. None unless asked for, and where
    the licence keeps them."""

    @property
    def shows_recorded(self) -> bool:
        """True if the first motion is the recorded one."""
        return self.motions[0].label == RECORDED

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Times of the frames, seconds after the first."""
        return np.arange(self.n_frames) / self.fps

    @property
    def event_time(self) -> float:
        """Time of the event, seconds after the first frame."""
        return (self.n_frames - 1) / self.fps

    @property
    def goal_location(self) -> Float[np.ndarray, "3"] | None:
        """Location of the goal, canonical frame, metres; None without a goal."""
        return None if self.goal is None else self.goal.location

    @property
    def prime_frame(self) -> int:
        """The frame nearest to the prime time."""
        # A prime between two frames may round to the frame after the last.
        return int(np.clip(round(self.prime_time * self.fps), 0, self.n_frames - 1))

    @property
    def picture_axis(self) -> Float[np.ndarray, "3"]:
        """Horizontal unit vector that points to the right in side views, so that the reach is seen from the side.

        It points from the first motion's pelvis to the goal at the event; without a goal, from where that pelvis began
        to where it ends.
        """
        pelvis = self.motions[0].joints[:, Joint.PELVIS]
        if self.goal is None:
            return horizontal_direction(pelvis[-1] - pelvis[0])
        return horizontal_direction(self.goal.location - pelvis[-1])
