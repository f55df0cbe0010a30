"""Compares the sequences of synthetic performances with what the study reports of the real datasets.

Targets and tolerance: docs/specification/synthetic-recordings.md#statistics. Measured on true gaze, without sensors;
what curation measures through sensors differs a little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicHermiteSpline

from prbench.geometry.skeleton import WRISTS, Joint, canonical_frame, invert_rigid, transform_points
from prbench.metrics.batch import MotionBatch
from prbench.metrics.prime_success import prime_success
from prbench.metrics.reach_success import reach_success
from prbench.metrics.targets import ScoringTargets
from prbench.protocol.manifests import load_protocol
from prbench.protocol.published import Spread, load_table_one
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
    """Return all events of a performance that should become sequences."""
    return [_clip(performance, event) for event in performance.events if event.expected == "sequence"]


def _clip(performance: Performance, event: TrueEvent) -> TrueClip:
    assert event.prime_time is not None  # expected to become a sequence
    # Counted backwards from the event, which lies exactly on the last frame.
    n_frames = int(np.floor((event.event_time - event.prime_time + PREROLL) * FPS + 1e-6)) + 1
    times = event.event_time - np.arange(n_frames)[::-1] / FPS
    times = np.clip(times, performance.times[0], performance.times[-1])
    return TrueClip(event, float(times[0]), sample_joints(performance, times), performance.person.neck_tilt_deg)


def sample_joints(performance: Performance, times: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m 22 3"]:
    """Return joints between frames, by cubic interpolation: linear interpolation would add jerk of its own."""
    first, last = np.searchsorted(performance.times, [times[0], times[-1]])
    part = slice(max(int(first) - 3, 0), int(last) + 4)
    velocity = np.gradient(performance.joints[part], performance.times[part], axis=0)
    return CubicHermiteSpline(performance.times[part], performance.joints[part], velocity, axis=0)(times)


@dataclass(frozen=True)
class SequenceStatistics:
    """The columns of the study's Table 1 for one dataset: seconds and metres."""

    duration: Spread
    gap: Spread
    body: Spread
    hand: Spread

    def deviations(self, target: SequenceStatistics) -> dict[str, float]:
        """Return (ours - target) / target sd of every mean."""
        names = ("duration", "gap", "body", "hand")
        pairs = {name: (getattr(self, name), getattr(target, name)) for name in names}
        return {name: (ours.mean - theirs.mean) / theirs.sd for name, (ours, theirs) in pairs.items()}


TARGETS: Mapping[str, SequenceStatistics] = MappingProxyType(
    {
        dataset: SequenceStatistics(row.duration, row.prime_gap, row.body_movement, row.hand_movement)
        for dataset, row in load_table_one().items()
    }
)
"""The study's numbers of the real datasets."""


def sequence_statistics(clips: Sequence[TrueClip]) -> SequenceStatistics:
    """Return mean and spread of the four numbers over sequences."""
    gaps = np.array([clip.event.event_time - clip.start - clip.prime_after for clip in clips])
    return SequenceStatistics(
        duration=_spread(gaps + PREROLL),
        gap=_spread(gaps),
        body=_spread(np.array([clip.body_movement for clip in clips])),
        hand=_spread(np.array([clip.hand_movement for clip in clips])),
    )


def _spread(values: np.ndarray) -> Spread:
    return Spread(float(values.mean()), float(values.std()))


@dataclass(frozen=True)
class TruthScores:
    """Metrics of the truth itself: ceilings for every method (rates from 0 to 1)."""

    prime_equation: float
    prime_onset: float
    reach_any: float
    reach_final: float


def truth_scores(clips: Sequence[TrueClip]) -> TruthScores:
    """Score the true motion of some sequences against their own goals."""
    frames = [invert_rigid(canonical_frame(clip.joints)) for clip in clips]
    motions = [transform_points(frame, clip.joints) for frame, clip in zip(frames, clips, strict=True)]
    goals = [transform_points(frame, clip.event.goal) for frame, clip in zip(frames, clips, strict=True)]
    batch = MotionBatch.from_motions(motions)
    constants = load_protocol().metrics
    targets = ScoringTargets(
        goal_location=np.array(goals),
        prime_time=np.array([clip.prime_after for clip in clips]),
        hand=np.array([int(clip.event.hand == "right") for clip in clips]),
        head_tilt_deg=np.array([clip.neck_tilt_deg for clip in clips]),
        fps=FPS,
    )
    return TruthScores(
        prime_equation=float(prime_success(batch, targets, constants, variant="equation").mean()),
        prime_onset=float(prime_success(batch, targets, constants, variant="onset").mean()),
        reach_any=float(reach_success(batch, targets.goal_location, constants).mean()),
        reach_final=float(reach_success(batch, targets.goal_location, constants, final=True).mean()),
    )


def clips_of(performances: Sequence[Performance]) -> list[TrueClip]:
    """Return the sequences of several performances."""
    return [clip for performance in performances for clip in true_clips(performance)]
