"""The sequences that perfect curation would cut from a performance, at 20 frames a second.

For looking at performances and for measuring them; the sequence table itself is made by curation, from sensors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

from prbench.skeleton import WRISTS, Joint
from prbench.synthetic.performance import Performance, TrueEvent

PREROLL = 2.0
"""Seconds before the prime time (docs/specification/curation.md#clip)."""
FPS = 20.0
"""Frames a second (docs/specification/constants.md#protocol)."""


@dataclass(frozen=True)
class TrueClip:
    """One pick or put from two seconds before its prime time to the event; world frame."""

    event: TrueEvent
    start: float
    """Time of the first frame, seconds of the recording."""
    joints: Float[np.ndarray, "n 22 3"]
    neck_tilt_deg: float

    @property
    def prime_after(self) -> float:
        """Prime time in seconds after the first frame."""
        assert self.event.prime_time is not None  # clips are made of primed events only
        return self.event.prime_time - self.start

    @property
    def body_movement(self) -> float:
        """Largest distance of the pelvis from where it was in the first frame, metres."""
        pelvis = self.joints[:, Joint.PELVIS]
        return float(np.linalg.norm(pelvis - pelvis[0], axis=1).max())

    @property
    def hand_movement(self) -> float:
        """The same for the reaching wrist relative to the pelvis (translation removed, heading not)."""
        wrist = self.joints[:, WRISTS[self.event.hand == "right"]] - self.joints[:, Joint.PELVIS]
        return float(np.linalg.norm(wrist - wrist[0], axis=1).max())


def true_clips(performance: Performance) -> list[TrueClip]:
    """All events of a performance that should become sequences."""
    return [_clip(performance, event) for event in performance.events if event.expected == "sequence"]


def _clip(performance: Performance, event: TrueEvent) -> TrueClip:
    assert event.prime_time is not None  # expected to become a sequence
    n_frames = int(np.floor((event.event_time - event.prime_time + PREROLL) * FPS + 1e-6)) + 1
    times = event.event_time - np.arange(n_frames)[::-1] / FPS
    times = np.clip(times, performance.times[0], performance.times[-1])
    return TrueClip(event, float(times[0]), sample_joints(performance, times), performance.person.neck_tilt_deg)


def sample_joints(performance: Performance, times: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 22 3"]:
    """Joints between frames, by cubic interpolation: linear interpolation would add jerk of its own."""
    first, last = np.searchsorted(performance.times, [times[0], times[-1]])
    part = slice(max(int(first) - 3, 0), int(last) + 4)
    velocity = np.gradient(performance.joints[part], performance.times[part], axis=0)
    return CubicHermiteSpline(performance.times[part], performance.joints[part], velocity, axis=0)(times)
