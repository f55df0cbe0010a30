"""A motion and what truly happens in it, in words: what every exit of the corpus starts from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class TrueNarration:
    """One span of text."""

    kind: Literal["atomic_action", "motion_narration", "activity_summarization"]
    start: float
    """Seconds from the recording's first frame."""
    end: float
    texts: tuple[str, ...]
    """One for each answer of the kind."""
    activities: tuple[str, ...]
    """What happens, by name; for checks, never written."""


@dataclass(frozen=True)
class NarratedMotion:
    """One recording of the corpus, noise-free. Metres, Y up, floor at y = 0; quaternions w x y z, segment to world."""

    recording_id: str
    participant_id: str
    split: Literal["train", "validation", "test"]
    rate: float
    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 4"]
    """See :class:`prbench.synthetic.performance.Performance`."""
    head_rotation: Float[np.ndarray, "n 4"]
    """True head: x left, y up, z forward."""
    eye: Float[np.ndarray, "n 3"]
    planted: Bool[np.ndarray, "n 2"]
    neck_tilt_deg: float
    narrations: tuple[TrueNarration, ...]

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Seconds from the first frame."""
        return np.arange(len(self.joints)) / self.rate

    @property
    def duration(self) -> float:
        """Seconds from first to last frame."""
        return (len(self.joints) - 1) / self.rate
