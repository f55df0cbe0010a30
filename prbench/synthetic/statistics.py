"""How the sequences of synthetic performances compare with what the study reports of the real datasets.

Targets and tolerance: docs/specification/synthetic-recordings.md#statistics. Measured on true gaze, without sensors;
what curation measures through sensors differs a little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from prbench.manifests import load_protocol
from prbench.metrics.batch import MotionBatch
from prbench.metrics.prime_success import prime_success
from prbench.metrics.reach_success import reach_success
from prbench.metrics.targets import ScoringTargets
from prbench.published import Spread, load_table_one
from prbench.skeleton import canonical_frame, invert_rigid, transform_points
from prbench.synthetic.performance import Performance
from prbench.synthetic.true_clips import FPS, TrueClip, true_clips


@dataclass(frozen=True)
class SequenceStatistics:
    """What Table 1 of the study reports of a dataset: seconds and metres."""

    duration: Spread
    gap: Spread
    body: Spread
    hand: Spread

    def deviations(self, target: SequenceStatistics) -> dict[str, float]:
        """(ours - target) / target sd of every mean."""
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
    """Mean and spread of the four numbers over sequences."""
    gaps = np.array([clip.event.event_time - clip.start - clip.prime_after for clip in clips])
    return SequenceStatistics(
        duration=_spread(gaps + 2.0),
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
    batch, constants = MotionBatch.from_motions(motions), load_protocol().metrics
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
    """The sequences of several performances."""
    return [clip for performance in performances for clip in true_clips(performance)]
