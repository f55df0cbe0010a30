"""What the truth of a performance says about its sequences, for comparisons with curated ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

from prbench.geometry.skeleton import WRISTS, Joint
from prbench.synthetic.performance import Performance, TrueEvent


def read_truth(tree: Path, name: str) -> pa.Table:
    """Read one table of a tree's truth: a file, or a folder with one a recording."""
    path = tree / "truth" / f"{name}.parquet"
    return pq.read_table(path if path.is_file() else path.with_suffix(""))


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
    """Return all events of a performance that should become sequences."""
    clips = []
    for event in performance.events:
        if event.expected == "sequence" and event.prime_time is not None:
            # Counted backwards from the event, which lies exactly on the last frame.
            n_frames = int(np.floor((event.event_time - event.prime_time + PREROLL) * FPS + 1e-6)) + 1
            times = event.event_time - np.arange(n_frames)[::-1] / FPS
            times = np.clip(times, performance.times[0], performance.times[-1])
            joints = sample_joints(performance, times)
            clips.append(TrueClip(event, float(times[0]), joints, performance.person.neck_tilt_deg))
    return clips


def sample_joints(performance: Performance, times: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 22 3"]:
    """Return joints between frames, by cubic interpolation: linear interpolation would add jerk of its own."""
    first, last = np.searchsorted(performance.times, [times[0], times[-1]])
    part = slice(max(int(first) - 3, 0), int(last) + 4)
    velocity = np.gradient(performance.joints[part], performance.times[part], axis=0)
    return CubicHermiteSpline(performance.times[part], performance.joints[part], velocity, axis=0)(times)


def clips_of(performances: Sequence[Performance]) -> list[TrueClip]:
    """Return the sequences of several performances."""
    return [clip for performance in performances for clip in true_clips(performance)]
