"""Recordings as runs of frames at the windows' rate, and the windows in them.

Source: docs/specification/motion-prediction.md#from-recordings-to-windows. Nothing that a predictor sees is made from a
sample later than its frame, except body frames in gaps (no window's observation ends in one) and bodies whose
rate is no multiple of the windows' rate.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.geometry.skeleton import head_forward
from prbench.geometry.timelines import covered, interpolate, nearest_index
from prbench.prediction.protocol import WindowRules
from prbench.prediction.table import CutRun, Run, Window
from prbench.recording.published_tracks import PublishedTrack
from prbench.recording.streams import BodyStream, Recording

_ROUNDING = 1e-6  # seconds
_RATE_TOLERANCE = 0.005
"""Share by which a rate may differ from a multiple of the windows' rate: 29.97 is 30, EgoAllo's 30.3 is not."""


def runs_of_recording(recording: Recording, rules: WindowRules, *, split: str) -> Iterator[CutRun]:
    """Runs of the 22 joints, cut where the body is missing for longer than the largest gap.

    Args:
        recording: With a body; one without yields nothing.
        rules: Rate, lengths and limits.
        split: The recording's split.
    """
    body = recording.body
    if body is None or not body.valid.any():
        return
    times, joints, filled, posed = _resampled(body, rules)
    directions, _ = head_forward(joints, recording.head_tilt_deg)
    gaze = recording.gaze
    looks, looking = latest_gaze(gaze.times, gaze.direction, gaze.valid, times, oldest=rules.largest_gaze_age)
    for number, (first, stop) in enumerate(_stretches(posed)):
        if stop - first <= rules.length:
            continue
        part = slice(first, stop)
        run = Run(
            run_id=f"{recording.recording_id}/{number}",
            recording_id=recording.recording_id,
            participant_id=recording.participant_id,
            split=split,
            published_split="",
            segment=str(number),
            pose_source=recording.pose_source,
            fps=rules.fps,
            start_time=float(times[first]),
            joints=joints[part],
            joints_valid=posed[part],
            # What was seen before the run began may be held into it: it lies in the past, too.
            gaze=looks[part],
            gaze_valid=looking[part],
            head_direction=directions[part],
        )
        yield CutRun(run, sliding_windows(run, filled[part], rules))


def runs_of_tracks(
    recording: Recording, tracks: tuple[PublishedTrack, ...], rules: WindowRules, *, split: str, published_split: str
) -> Iterator[CutRun]:
    """One run for each published segment, whole, with every window that the study counts.

    Args:
        recording: The recording that the segments are pieces of.
        tracks: The segments.
        rules: Rate, lengths and limits.
        split: The recording's split.
        published_split: That of the published evaluation, where the segments do not tell it themselves.
    """
    for track in tracks:
        directions, _ = head_forward(track.body, recording.head_tilt_deg)
        oldest = rules.largest_gaze_age
        looks, looking = latest_gaze(track.times, track.gaze, track.gaze_measured, track.times, oldest=oldest)
        run = Run(
            run_id=f"{recording.recording_id}/{track.name}",
            recording_id=recording.recording_id,
            participant_id=recording.participant_id,
            split=split,
            published_split=track.published_split or published_split,
            segment=track.name,
            pose_source=recording.pose_source,
            fps=rules.fps,
            start_time=float(track.times[0]),
            joints=track.joints,
            joints_valid=track.valid,
            gaze=looks,
            gaze_valid=looking,
            head_direction=directions,
        )
        yield CutRun(run, sliding_windows(run, track.filled, rules))


def window_starts(n_frames: int, rules: WindowRules) -> Int[np.ndarray, " n"]:
    """Starts 0, stride, 2 stride, … below ``n_frames`` minus the length of a window, which is excluded itself."""
    return np.arange(0, max(n_frames - rules.length, 0), rules.stride)


def sliding_windows(run: Run, filled: Bool[np.ndarray, " n"], rules: WindowRules) -> tuple[Window, ...]:
    """Every window of a run; those that must not be scored say why.

    Args:
        run: The frames.
        filled: Frames that were interpolated across a gap, and so tell of a later one.
        rules: Lengths.
    """
    windows = []
    for start in window_starts(len(run), rules).tolist():
        border = start + rules.observed_frames
        exclusion = ""
        if not run.joints_valid[start : start + rules.length].all():
            exclusion = "invalid_body"
        elif filled[border - 1]:
            exclusion = "gap_at_border"
        looking = int(run.gaze_valid[start:border].sum())
        windows.append(Window(start, looking, rules.future_frames, exclusion))
    return tuple(windows)


def latest_gaze(
    times: Float[np.ndarray, " m"],
    directions: Float[np.ndarray, "m 3"],
    valid: Bool[np.ndarray, " m"],
    frames: Float[np.ndarray, " n"],
    *,
    oldest: float,
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The last valid sample not later than each frame; interpolating would read the future across a window's border.

    Args:
        times: Of the samples, seconds.
        directions: Unit vectors.
        valid: Samples that were measured.
        frames: Seconds.
        oldest: Age above which a sample no longer counts, seconds.

    Returns:
        Directions (+Z before the first sample), and where the sample is young enough.
    """
    known = times[valid]
    latest = np.searchsorted(known, frames + _ROUNDING, side="right") - 1
    if not len(known):
        return np.tile([0.0, 0.0, 1.0], (len(frames), 1)), np.zeros(len(frames), dtype=bool)
    there = latest >= 0
    age = frames - known[np.maximum(latest, 0)]
    held = directions[valid][np.maximum(latest, 0)]
    return np.where(there[:, None], held, [0.0, 0.0, 1.0]), there & (age <= oldest + _ROUNDING)


def _resampled(
    body: BodyStream, rules: WindowRules
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 22 3"], Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Frame times, joints, where they were filled across a gap, and where there is a body at all."""
    known = body.times[body.valid]
    poses = body.joints[body.valid]
    period = float(np.median(np.diff(body.times))) if len(body.times) > 1 else 1.0 / rules.fps
    frames = int(np.floor((known[-1] - known[0]) * rules.fps + _ROUNDING)) + 1
    times = known[0] + np.arange(frames) / rules.fps
    posed = covered(known, np.ones(len(known), dtype=bool), times, max_gap=rules.largest_gap)
    ratio = 1.0 / (period * rules.fps)
    if round(ratio) >= 1 and abs(ratio / round(ratio) - 1) <= _RATE_TOLERANCE:
        nearest = nearest_index(known, times)
        sampled = np.abs(known[nearest] - times) <= 0.5 * period + _ROUNDING
        joints = np.where(sampled[:, None, None], poses[nearest], interpolate(known, poses, times))
        return times, joints, posed & ~sampled, posed | sampled
    right = np.clip(np.searchsorted(known, times), 1, max(len(known) - 1, 1))
    # Between neighbours of the source's own rate there is no gap, whatever its rate.
    apart = np.diff(known)[right - 1] if len(known) > 1 else np.zeros(len(times))
    return times, interpolate(known, poses, times), posed & (apart > 1.5 * period), posed


def _stretches(posed: Bool[np.ndarray, " n"]) -> list[tuple[int, int]]:
    """First frame and end of every stretch of frames with a body."""
    steps = np.flatnonzero(np.diff(np.concatenate(([False], posed, [False])).astype(np.int8)))
    return [(int(first), int(stop)) for first, stop in steps.reshape(-1, 2)]
