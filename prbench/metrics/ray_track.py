"""Distance of a looking ray from the goal and its turning speed, frame by frame: the evidence for priming."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.geometry.skeleton import Joint, head_forward
from prbench.metrics.batch import GazeRays, MotionBatch, moving_sum, odd_window, ranges
from prbench.protocol.manifests import MetricConstants

_TIME_TOLERANCE = 1e-9  # seconds

PerSequence = Float[np.ndarray, " n"]
Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class CandidateFrames:
    """The frames of each sequence at which priming may begin (docs/specification/metrics.md#prime-success).

    Frames around the prime time, of which frames 0 and 1 (whose head direction has no acceleration) and the last
    ``hold`` frames (whose stay on the target cannot be seen to its end) are left out.

    Attributes:
        last: Inclusive; before ``first`` where a sequence has no candidate.
        hold: K: the ray must stay on the target in frame t and the K frames after it.
        before: Frames before t that an arrival may have begun in: those of ``prime_window`` seconds.
    """

    first: Int[np.ndarray, " n"]
    last: Int[np.ndarray, " n"]
    hold: Int[np.ndarray, " n"]
    before: Int[np.ndarray, " n"]

    @property
    def count(self) -> Int[np.ndarray, " n"]:
        """Number of candidates of each sequence."""
        return np.maximum(self.last - self.first + 1, 0)


def candidate_frames(
    n_frames: Int[np.ndarray, " n"], prime_time: PerSequence, fps: PerSequence, constants: MetricConstants
) -> CandidateFrames:
    """Frames t with t / fps in ``[prime_time - prime_window, prime_time + prime_window]`` and room for the stay."""
    # K = ceil(tau f): 0.1 s at 20 fps are 2 frames, and 2 + 1e-16 must not become 3.
    hold = np.ceil(constants.prime_duration * fps - 1e-9).astype(np.int64)
    begin = np.ceil((prime_time - constants.prime_window - _TIME_TOLERANCE) * fps).astype(np.int64)
    end = np.floor((prime_time + constants.prime_window + _TIME_TOLERANCE) * fps).astype(np.int64)
    before = np.floor((constants.prime_window + _TIME_TOLERANCE) * fps).astype(np.int64)
    return CandidateFrames(np.maximum(begin, 2), np.minimum(end, n_frames - 1 - hold), hold, before)


@dataclass(frozen=True, eq=False)
class RayTrack:
    """Distance and turning speed of a ray in the frames that the candidates of each sequence depend on.

    Attributes:
        distance: Distance between goal and ray (not the line), metres.
        angle: Angle between the ray and the direction from its origin to the goal, degrees.
        speed: Turn since the frame before, rad/s; NaN where that is unknown.
        usable: False where the ray itself is not to be trusted; such a frame is off target.
        direction: Unit vectors of the ray, canonical frame.
        row_of_frame_0: ``row_of_frame_0[i] + t`` is the row of frame t of sequence i, where the track holds that frame.
    """

    distance: Float[np.ndarray, " rows"]
    angle: Float[np.ndarray, " rows"]
    speed: Float[np.ndarray, " rows"]
    usable: Bool[np.ndarray, " rows"]
    direction: Float[np.ndarray, "rows 3"]
    sequence: Int[np.ndarray, " rows"]
    row_of_frame_0: Int[np.ndarray, " n"]


def head_track(
    motion: MotionBatch,
    candidates: CandidateFrames,
    goal_location: Points,
    head_tilt_deg: PerSequence,
    fps: PerSequence,
    constants: MetricConstants,
) -> RayTrack:
    """Return the head-forward ray against the goal; frames without a defined head frame are not usable.

    Args:
        motion: Canonical frame, metres.
        candidates: Decide which frames are looked at.
        goal_location: Same frame and unit.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
        fps: Frames per second.
        constants: Thresholds of the protocol; with ``head_smoothing`` above 0 the joints are averaged over time first.
    """
    rows, sequence, row_of_frame_0 = _rows_looked_at(motion, candidates)
    values = motion.values
    if constants.head_smoothing > 0:
        # Joints averaged over a centred window, which is shorter near the ends of a sequence.
        flat = motion.columns.reshape(-1, len(motion.values))
        smooth = np.empty_like(flat)
        windows = np.array([odd_window(constants.head_smoothing, rate) for rate in fps])[motion.sequence_of_row]
        for window in np.unique(windows):
            of_window = windows == window
            counts = moving_sum(np.ones((1, len(motion.values))), motion, int(window))
            smooth[:, of_window] = (moving_sum(flat, motion, int(window)) / counts)[:, of_window]
        values = smooth.T.reshape(motion.values.shape)
    joints = values[rows].astype(np.float64)
    direction, degenerate = head_forward(joints, head_tilt_deg[sequence])
    ray = joints[:, Joint.HEAD], direction
    return _track(ray, ~degenerate, goal_location[sequence], sequence, row_of_frame_0, fps)


def gaze_track(
    motion: MotionBatch, gaze: GazeRays, candidates: CandidateFrames, goal_location: Points, fps: PerSequence
) -> RayTrack:
    """Return the gaze ray against the goal.

    An invalid sample is off target, and the turn into it and out of it is unknown.

    Args:
        motion: The motion whose frames the gaze belongs to.
        gaze: One ray a frame.
        candidates: Decide which frames are looked at.
        goal_location: Canonical frame, metres.
        fps: Frames per second.
    """
    rows, sequence, row_of_frame_0 = _rows_looked_at(motion, candidates)
    ray = gaze.origin[rows].astype(np.float64), gaze.direction[rows].astype(np.float64)
    valid = gaze.valid[rows]
    track = _track(ray, valid, goal_location[sequence], sequence, row_of_frame_0, fps)
    # A turn has two ends: both the one into an invalid sample and the one out of it are unknown.
    track.speed[~valid] = np.nan
    track.speed[1:][~valid[:-1]] = np.nan
    return track


def _track(
    ray: tuple[np.ndarray, np.ndarray],
    usable: np.ndarray,
    goal: np.ndarray,
    sequence: np.ndarray,
    row_of_frame_0: np.ndarray,
    fps: np.ndarray,
) -> RayTrack:
    """Hold a ray, its origin and direction, against the goal of each row."""
    origin, direction = ray
    before = direction[:-1]
    after = direction[1:]
    sine = np.linalg.norm(np.cross(before, after), axis=-1)
    cosine = (before * after).sum(axis=-1)
    # atan2 of sine and cosine is exact for small turns, where arccos loses half of the digits.
    speed = np.full(len(direction), np.nan)
    speed[1:] = fps[sequence[1:]] * np.arctan2(sine, cosine)
    speed[1:][sequence[1:] != sequence[:-1]] = np.nan
    to_goal = goal - origin
    across = np.linalg.norm(np.cross(direction, to_goal), axis=-1)
    along = (direction * to_goal).sum(axis=-1)
    distance = ray_distance(origin, direction, goal)
    angle = np.rad2deg(np.arctan2(across, along))
    return RayTrack(distance, angle, speed, usable, direction, sequence, row_of_frame_0)


def ray_distance(
    origin: Float[np.ndarray, "rows 3"], direction: Float[np.ndarray, "rows 3"], point: Float[np.ndarray, "_ 3"]
) -> Float[np.ndarray, " rows"]:
    """Distance between points and rays, pair by pair or one point for all; behind a ray's origin, from that origin."""
    # A ray, not a line: for a target behind the origin a line would call looking away a success.
    to_point = point - origin
    along = np.maximum((to_point * direction).sum(axis=-1, keepdims=True), 0.0)
    return np.linalg.norm(to_point - along * direction, axis=-1)


def _rows_looked_at(motion: MotionBatch, candidates: CandidateFrames) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the motion that some candidate depends on, the sequence of each, and where frame 0 would lie."""
    # Turning speeds reach back, too, and so does a stay whose end alone lies among the frames before a candidate.
    before = np.maximum(2, candidates.before) + candidates.hold
    begin = np.maximum(candidates.first - before, 0)
    count = np.where(candidates.count > 0, candidates.last + candidates.hold + 1 - begin, 0)
    rows = ranges(motion.first + begin, count)
    return rows, np.repeat(np.arange(motion.n_sequences), count), np.cumsum(count) - count - begin


def untrusted(track: RayTrack, candidates: CandidateFrames) -> Bool[np.ndarray, " n"]:
    """Return True for each sequence with a frame that is not usable among those that decide stay and deceleration."""
    frame = np.arange(len(track.sequence)) - track.row_of_frame_0[track.sequence]
    begin = (candidates.first - np.maximum(candidates.hold, 2))[track.sequence]
    found = np.zeros(len(candidates.count), dtype=bool)
    found[track.sequence[~track.usable & (frame >= begin)]] = True
    return found
