"""Prime Success by gaze: what the eyes do where Prime Success asks the head."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.metrics.batch import MotionBatch, ScoringPair, ScoringTargets
from prbench.metrics.prime_success import Variant, primed
from prbench.metrics.ray_track import CandidateFrames, RayTrack, candidate_frames, gaze_track, untrusted
from prbench.metrics.registry import MetricFamily, MetricValues, detail
from prbench.protocol.manifests import MetricConstants


def prime_success_gaze(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants, *, variant: Variant = "equation"
) -> Float[np.ndarray, " n"]:
    """1 where the gaze primes the goal: the conditions of ``prime_success`` with the gaze ray.

    Args:
        motion: The motion that the gaze belongs to; its lengths only.
        targets: Goals, prime times and the gaze of that motion, recorded or generated.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        variant: Which of the readings.

    Raises:
        ValueError: if the targets hold no gaze.
    """
    candidates, track = _evidence(motion, targets, constants)
    return primed(track, candidates, constants, variant)


def _evidence(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> tuple[CandidateFrames, RayTrack]:
    if targets.gaze is None:
        raise ValueError("the targets hold no gaze")
    motion.require_frames(2)
    fps = targets.fps_of_sequence
    candidates = candidate_frames(motion.n_frames, targets.prime_time, fps, constants)
    return candidates, gaze_track(motion, targets.gaze, candidates, targets.goal_location, fps)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, ...]:
    candidates, track = _evidence(pair.predicted, pair.targets, constants)
    flags = {"no_candidate_frames": candidates.count == 0, INVALID: untrusted(track, candidates)}
    return (
        MetricValues("prime_success_gaze", primed(track, candidates, constants, "equation"), flags),
        MetricValues("prime_success_gaze_arrival", primed(track, candidates, constants, "arrival"), flags),
    )


# Flag of a sequence with a frame without gaze among those that decide.
INVALID = "invalid_gaze_samples"

_METRICS = (
    detail("prime_success_gaze", "Prime Success (gaze)", "rate", 28, higher_is_better=True),
    detail("prime_success_gaze_arrival", "Prime Success (gaze, arrival)", "rate", 29, higher_is_better=True),
)
FAMILY = MetricFamily(_METRICS, _compute, needs_gaze=True)
