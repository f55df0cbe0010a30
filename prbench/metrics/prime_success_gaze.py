"""Prime Success by gaze: what the recorded eyes do where Prime Success asks the head."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.manifests import MetricConstants
from prbench.metrics.batch import MotionBatch
from prbench.metrics.prime_success import primed
from prbench.metrics.ray_track import CandidateFrames, RayTrack, candidate_frames, gaze_track, untrusted
from prbench.metrics.registry import MetricFamily, MetricInfo, MetricValues
from prbench.metrics.targets import ScoringPair, ScoringTargets


def prime_success_gaze(
    recorded: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> Float[np.ndarray, " n"]:
    """1 where the recorded gaze primes the goal: the conditions of ``prime_success`` with the gaze ray.

    Args:
        recorded: The recorded motion; its lengths only.
        targets: With gaze.
        constants: Of the protocol.

    Raises:
        ValueError: if the targets hold no gaze.
    """
    candidates, track = _evidence(recorded, targets, constants)
    return primed(track, candidates, constants, "equation")


def _evidence(
    recorded: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> tuple[CandidateFrames, RayTrack]:
    if targets.gaze is None:
        raise ValueError("the targets hold no gaze")
    recorded.require_frames(2)
    fps = targets.fps_of_sequence
    candidates = candidate_frames(recorded.n_frames, targets.prime_time, fps, constants)
    return candidates, gaze_track(recorded, targets.gaze, candidates, targets.goal_location, fps)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues]:
    candidates, track = _evidence(pair.recorded, pair.targets, constants)
    flags = {
        "no_candidate_frames": candidates.count == 0,
        "invalid_gaze_samples": untrusted(track, candidates),
    }
    return (MetricValues("prime_success_gaze", primed(track, candidates, constants, "equation"), flags),)


FAMILY = MetricFamily(
    (
        MetricInfo(
            "prime_success_gaze",
            "Prime Success (recorded gaze)",
            "rate",
            higher_is_better=True,
            main=False,
            position=28,
            compares_with_recorded=False,
        ),
    ),
    _compute,
    needs_gaze=True,
)
