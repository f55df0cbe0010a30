"""Prime Success: whether the head turns to the goal around the recorded prime time, and stays on it."""

from __future__ import annotations

from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.metrics.batch import MotionBatch, ScoringPair, ScoringTargets, ranges
from prbench.metrics.ray_track import CandidateFrames, RayTrack, candidate_frames, head_track, untrusted
from prbench.metrics.registry import MetricFamily, MetricValues, detail, headline
from prbench.protocol.manifests import MetricConstants

Numbers = Float[np.ndarray, " n"]

Variant = Literal["equation", "arrival", "onset", "angle"]


def prime_success(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants, *, variant: Variant = "equation"
) -> Numbers:
    """1 where the head primes the goal (*Prime and Reach*, eq. 3; docs/specification/metrics.md#prime-success).

    There must be a frame t within ``prime_window`` of the recorded prime time such that the head-forward ray stays
    within ``prime_distance`` of the goal for ``prime_duration`` from t on, and the head decelerates at t:

    * ``equation``: the turning speed at t is below that of the frame before.
    * ``arrival``: as ``equation``, and the ray comes from elsewhere. In the frames of ``prime_window`` before t, frame
      0 included, it was farther than ``prime_distance`` + ``arrival_margin`` from the goal for as many frames as a stay
      has, and had not stayed there before. A look at the goal from the start, and a nod off it and back, are none.
    * ``angle``: as ``equation``, with an angle of at most ``prime_angle_deg`` between the ray and the direction to the
      goal in place of the distance.
    * ``onset``: frame t - 1 is off target, and the mean speed of the K turns after t is below that of the K turns
      up to t. This is what the study's prose asks for.

    Args:
        motion: Canonical frame, metres.
        targets: Goal, prime time, head tilt and frame rate of each sequence.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        variant: Which of the readings.
    """
    candidates, track = _evidence(motion, targets, constants)
    return primed(track, candidates, constants, variant)


def primed(track: RayTrack, candidates: CandidateFrames, constants: MetricConstants, variant: Variant) -> Numbers:
    """Apply the conditions of :func:`prime_success` to the track of any ray.

    Args:
        track: Distance and turning speed of the ray, frame by frame.
        candidates: Frames at which priming may begin.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
        variant: Which of the readings.
    """
    on_target = track.usable & near_goal(track, constants, variant)
    sequence = np.repeat(np.arange(len(candidates.count)), candidates.count)
    frame = ranges(candidates.first, candidates.count)
    row = track.row_of_frame_0[sequence] + frame
    hold = candidates.hold[sequence]
    # A look may begin where the ray is on target and stays there for the ``hold`` frames after.
    chosen = on_target[row]
    longest = int(hold.max(initial=0))
    for k in range(1, longest + 1):
        chosen &= on_target[row + np.minimum(k, hold)]
    # Turning speed has no value in frame 0, so the mean of K speeds up to t needs t >= max(2, K).
    if variant == "onset":
        chosen &= (frame >= np.maximum(2, hold)) & ~on_target[row - 1]
    if variant == "arrival":
        earliest = track.row_of_frame_0[sequence] + np.maximum(frame - candidates.before[sequence], 0)
        away_from = constants.prime_distance + constants.arrival_margin + constants.threshold_tolerance
        # Where the ray is not defined, nobody can say that it was elsewhere.
        left = _last(track.usable & (track.distance > away_from), candidates.hold + 1, track)
        stayed = _last(on_target, candidates.hold + 1, track)
        chosen &= (left[row] >= earliest) & (stayed[np.maximum(left[row], 0)] < earliest)
    row = row[chosen]
    hold = hold[chosen]
    sequence = sequence[chosen]
    speed = track.speed
    if variant == "onset":
        # Mean of the ``hold`` speeds after each row minus that of the ``hold`` speeds up to it. Sequences hold for
        # different numbers of frames: beyond its own K, a sequence adds nothing.
        last = hold - 1
        change = np.zeros(len(row))
        for k in range(longest):
            step = speed[row + 1 + np.minimum(k, last)] - speed[row - np.minimum(k, last)]
            change += np.where(k < hold, step, 0.0)
        change /= hold
    else:
        change = speed[row] - speed[row - 1]
    # A head that turns at constant speed changes it by rounding alone, which the tolerance keeps from counting.
    success = np.zeros(len(candidates.count))
    success[sequence[change < -constants.deceleration_tolerance]] = 1.0
    return success


def _last(mask: Bool[np.ndarray, " rows"], frames: Int[np.ndarray, " n"], track: RayTrack) -> Int[np.ndarray, " rows"]:
    """Return the latest row up to each row at which the mask has held for so many frames of a sequence; -1 before.

    Args:
        mask: What is asked of each row.
        frames: Frames that it must have held for, one number a sequence.
        track: Says which rows belong to which sequence.
    """
    rows = np.arange(len(mask))
    # The last row that does not fulfil it, or the one before the sequence.
    unfulfilled = np.maximum.accumulate(np.where(mask, -1, rows))
    unfulfilled = np.maximum(unfulfilled, np.searchsorted(track.sequence, track.sequence) - 1)
    return np.maximum.accumulate(np.where(rows - unfulfilled >= frames[track.sequence], rows, -1))


def near_goal(track: RayTrack, constants: MetricConstants, variant: Variant) -> Bool[np.ndarray, " rows"]:
    """Return True for each row whose ray is near enough to the goal."""
    # The tolerance puts a value on the threshold inside: tables hold positions as float32.
    if variant == "angle":
        return track.angle <= constants.prime_angle_deg + np.rad2deg(constants.threshold_tolerance)
    return track.distance <= constants.prime_distance + constants.threshold_tolerance


def _evidence(
    motion: MotionBatch, targets: ScoringTargets, constants: MetricConstants
) -> tuple[CandidateFrames, RayTrack]:
    motion.require_frames(2)
    fps = targets.fps_of_sequence
    candidates = candidate_frames(motion.n_frames, targets.prime_time, fps, constants)
    return candidates, head_track(motion, candidates, targets.goal_location, targets.head_tilt_deg, fps, constants)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, ...]:
    candidates, track = _evidence(pair.predicted, pair.targets, constants)
    flags = {"no_candidate_frames": candidates.count == 0, "degenerate_head_frames": untrusted(track, candidates)}
    return (
        MetricValues("prime_success", primed(track, candidates, constants, "equation"), flags),
        MetricValues("prime_success_arrival", primed(track, candidates, constants, "arrival"), flags),
        MetricValues("prime_success_onset", primed(track, candidates, constants, "onset"), flags),
        MetricValues("prime_success_angle", primed(track, candidates, constants, "angle"), flags),
    )


_METRICS = (
    headline("prime_success", "Prime Success", "rate", 1, higher_is_better=True, in_study=True),
    detail("prime_success_arrival", "Prime Success (arrival)", "rate", 2, higher_is_better=True),
    detail("prime_success_onset", "Prime Success (onset)", "rate", 11, higher_is_better=True),
    detail("prime_success_angle", "Prime Success (fixed angle)", "rate", 12, higher_is_better=True),
)
FAMILY = MetricFamily(_METRICS, _compute)
