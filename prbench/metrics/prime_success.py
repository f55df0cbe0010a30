"""Prime Success: whether the head turns to the goal around the recorded prime time, and stays on it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.manifests import MetricConstants
from prbench.metrics.batch import MotionBatch, ranges
from prbench.metrics.ray_track import CandidateFrames, RayTrack, candidate_frames, head_track
from prbench.metrics.registry import MetricFamily, MetricInfo, MetricValues
from prbench.metrics.targets import ScoringPair, ScoringTargets

Variant = Literal["equation", "onset"]


def prime_success(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants, *, variant: Variant = "equation"
) -> Float[np.ndarray, " n"]:
    """1 where the head primes the goal (*Prime and Reach*, eq. 3; docs/specification/metrics.md#prime-success).

    There must be a frame t within ``prime_window`` of the recorded prime time such that the head-forward ray stays
    within ``prime_distance`` of the goal for ``prime_duration`` from t on, and the head decelerates at t:

    * ``equation``: the turning speed at t is below that of the frame before.
    * ``onset``: frame t - 1 is off target, and the mean speed of the K turns after t is below that of the K turns
      up to t. This is what the study's prose asks for.

    Args:
        motion: Canonical frame, metres.
        targets: Goal, prime time, head tilt and frame rate of each sequence.
        constants: Of the protocol.
        variant: Which of the two readings.
    """
    candidates, track = _evidence(motion, targets, constants)
    return primed(track, candidates, constants, variant)


def primed(
    track: RayTrack, candidates: CandidateFrames, constants: MetricConstants, variant: Variant
) -> Float[np.ndarray, " n"]:
    """Apply the conditions of :func:`prime_success` to the track of any ray."""
    # The tolerance puts a distance on the threshold inside: tables hold positions as float32.
    on_target = track.usable & (track.distance <= constants.prime_distance + constants.threshold_tolerance)
    sequence = np.repeat(np.arange(len(candidates.count)), candidates.count)
    frame = ranges(candidates.first, candidates.count)
    row = track.row_of_frame_0[sequence] + frame
    hold = candidates.hold[sequence]
    chosen = _stays(on_target, row, hold)
    # Turning speed has no value in frame 0, so the mean of K speeds up to t needs t >= max(2, K).
    if variant == "onset":
        chosen &= (frame >= np.maximum(2, hold)) & ~on_target[row - 1]
    row = row[chosen]
    hold = hold[chosen]
    sequence = sequence[chosen]
    change = _change_at_onset(track.speed, row, hold) if variant == "onset" else track.speed[row] - track.speed[row - 1]
    # A head that turns at constant speed changes it by rounding alone, which the tolerance keeps from counting.
    success = np.zeros(len(candidates.count))
    success[sequence[change < -constants.deceleration_tolerance]] = 1.0
    return success


def _stays(on_target: np.ndarray, row: np.ndarray, hold: np.ndarray) -> Bool[np.ndarray, " candidates"]:
    """Return True for each row that is on target with the ``hold`` rows after it."""
    stays = on_target[row]
    for k in range(1, _largest(hold) + 1):
        stays &= on_target[row + np.minimum(k, hold)]
    return stays


def _change_at_onset(speed: np.ndarray, row: np.ndarray, hold: np.ndarray) -> Float[np.ndarray, " candidates"]:
    """Mean of the ``hold`` speeds after each row minus that of the ``hold`` speeds up to it."""
    change = np.zeros(len(row))
    for k in range(_largest(hold)):
        # Sequences hold for different numbers of frames: beyond its own K, a sequence adds nothing.
        last = hold - 1
        step = speed[row + 1 + np.minimum(k, last)] - speed[row - np.minimum(k, last)]
        change += np.where(k < hold, step, 0.0)
    return change / hold


def _largest(hold: np.ndarray) -> int:
    return int(hold.max(initial=0))


def _evidence(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> tuple[CandidateFrames, RayTrack]:
    motion.require_frames(2)
    fps = targets.fps_of_sequence
    candidates = candidate_frames(motion.n_frames, targets.prime_time, fps, constants)
    track = head_track(motion, candidates, targets.goal_location, targets.head_tilt_deg, fps, constants)
    return candidates, track


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, MetricValues]:
    candidates, track = _evidence(pair.predicted, pair.targets, constants)
    degenerate = np.zeros(pair.predicted.n_sequences, dtype=bool)
    degenerate[track.sequence[~track.usable]] = True
    flags = {"no_candidate_frames": candidates.count == 0, "degenerate_head_frames": degenerate}
    return (
        MetricValues("prime_success", primed(track, candidates, constants, "equation"), flags),
        MetricValues("prime_success_onset", primed(track, candidates, constants, "onset"), flags),
    )


FAMILY = MetricFamily(
    (
        MetricInfo(
            "prime_success",
            "Prime Success",
            "rate",
            higher_is_better=True,
            main=True,
            position=1,
            compares_with_recorded=False,
        ),
        MetricInfo(
            "prime_success_onset",
            "Prime Success (onset)",
            "rate",
            higher_is_better=True,
            main=False,
            position=11,
            compares_with_recorded=False,
        ),
    ),
    _compute,
)
