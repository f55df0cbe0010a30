"""Motions of different lengths in one array, the form in which every metric takes them, and the goals beside them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.geometry.shapes import Boxes
from prbench.geometry.skeleton import N_JOINTS, WRISTS

Points = Float[np.ndarray, "n 3"]


@dataclass(frozen=True, eq=False)
class MotionBatch:
    """Ragged batch: the frames of all sequences one after the other, and where each sequence begins.

    Attributes:
        values: Joint positions, canonical frame, metres; float32 or float64.
        offsets: Row of the first frame of each sequence, then the number of all frames.

    Raises:
        ValueError: if the offsets do not start at 0, do not end at the number of frames, or leave a sequence empty.
    """

    values: Float[np.ndarray, "frames 22 3"]
    offsets: Int[np.ndarray, " sequences_and_1"]

    def __post_init__(self) -> None:
        if self.values.shape[1:] != (N_JOINTS, 3):
            raise ValueError(f"expected joints of shape (frames, {N_JOINTS}, 3), found {self.values.shape}")
        if self.offsets[0] != 0 or self.offsets[-1] != len(self.values):
            found = f"found {self.offsets[0]} to {self.offsets[-1]}"
            raise ValueError(f"offsets must run from 0 to {len(self.values)}, {found}")
        empty = np.flatnonzero(np.diff(self.offsets) < 1)
        if empty.size:
            raise ValueError(f"sequence {empty[0]} has no frames")

    @classmethod
    def from_motions(cls, motions: Sequence[Float[np.ndarray, "_ 22 3"]]) -> MotionBatch:
        """Join motions of any lengths; the values are copied."""
        lengths = [len(motion) for motion in motions]
        values = np.concatenate(motions) if motions else np.empty((0, N_JOINTS, 3))
        return cls(values, np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]))

    @classmethod
    def from_padded(cls, values: Float[np.ndarray, "n padded 22 3"], n_frames: Int[np.ndarray, " n"]) -> MotionBatch:
        """Take the first ``n_frames[i]`` frames of each row; what the padding holds leaves no trace."""
        too_long = np.flatnonzero((n_frames > values.shape[1]) | (n_frames < 1))
        if too_long.size:
            row = too_long[0]
            raise ValueError(f"sequence {row}: {n_frames[row]} frames asked of {values.shape[1]} padded ones")
        kept = np.arange(values.shape[1]) < n_frames[:, None]
        return cls(values[kept], np.concatenate([[0], np.cumsum(n_frames, dtype=np.int64)]))

    @property
    def n_sequences(self) -> int:
        """Number of sequences."""
        return len(self.offsets) - 1

    @property
    def n_frames(self) -> Int[np.ndarray, " n"]:
        """Frames of each sequence."""
        return np.diff(self.offsets)

    @property
    def first(self) -> Int[np.ndarray, " n"]:
        """Row of each sequence's first frame."""
        return self.offsets[:-1]

    @property
    def last(self) -> Int[np.ndarray, " n"]:
        """Row of each sequence's last frame."""
        return self.offsets[1:] - 1

    @cached_property
    def sequence_of_row(self) -> Int[np.ndarray, " frames"]:
        """Sequence that each row belongs to."""
        return np.repeat(np.arange(self.n_sequences), self.n_frames)

    @cached_property
    def columns(self) -> Float[np.ndarray, "22 3 frames"]:
        """The joints in float64, time last: ``columns[Joint.HEAD]`` is the x, y and z track of the head."""
        rows = self.values.reshape(len(self.values), -1)
        return np.ascontiguousarray(rows.T, dtype=np.float64).reshape(N_JOINTS, 3, -1)

    def part(self, start: int, stop: int) -> MotionBatch:
        """Sequences ``start`` to ``stop - 1``, without copying."""
        begin = self.offsets[start]
        return MotionBatch(self.values[begin : self.offsets[stop]], self.offsets[start : stop + 1] - begin)

    def shortened(self, n_frames: Int[np.ndarray, " n"]) -> MotionBatch:
        """Return the first ``n_frames[i]`` frames of each sequence."""
        rows = ranges(self.first, n_frames)
        return MotionBatch(self.values[rows], np.concatenate([[0], np.cumsum(n_frames, dtype=np.int64)]))

    def chunk_bounds(self, max_frames: int) -> Iterator[tuple[int, int]]:
        """Consecutive runs of whole sequences with at most ``max_frames`` frames (or one sequence) each."""
        start = 0
        while start < self.n_sequences:
            # A sequence longer than a chunk still makes one of its own.
            stop = int(np.searchsorted(self.offsets, self.offsets[start] + max_frames, side="right")) - 1
            stop = max(stop, start + 1)
            yield start, stop
            start = stop

    def require_frames(self, minimum: int) -> None:
        """Refuse sequences that are too short.

        Raises:
            ValueError: naming the first such sequence.
        """
        short = np.flatnonzero(self.n_frames < minimum)
        if short.size:
            raise ValueError(f"sequence {short[0]}: expected {minimum} frames or more, found {self.n_frames[short[0]]}")

    def require_finite(self, name: str, *, counted_from: int = 0) -> None:
        """Refuse NaN and infinity.

        Args:
            name: Name of the motion, for the error.
            counted_from: Number of this batch's first sequence, for the error.

        Raises:
            ValueError: naming sequence and frame.
        """
        if np.isfinite(self.values).all():
            return
        row = int(np.flatnonzero(~np.isfinite(self.values).all(axis=(1, 2)))[0])
        sequence = int(np.searchsorted(self.offsets, row, side="right")) - 1
        frame = row - int(self.offsets[sequence])
        raise ValueError(f"{name} motion, sequence {sequence + counted_from}, frame {frame}: a joint is not finite")


def require_equal_lengths(predicted: MotionBatch, recorded: MotionBatch) -> None:
    """Refuse motions that are not frame by frame comparable (docs/specification/metrics.md#length-contract).

    Raises:
        ValueError: naming the first sequence whose length differs.
    """
    if predicted.n_sequences != recorded.n_sequences:
        raise ValueError(f"expected {recorded.n_sequences} predicted motions, found {predicted.n_sequences}")
    different = np.flatnonzero(predicted.n_frames != recorded.n_frames)
    if different.size:
        i = different[0]
        raise ValueError(f"sequence {i}: expected {recorded.n_frames[i]} frames, found {predicted.n_frames[i]}")


def ranges(starts: Int[np.ndarray, " n"], counts: Int[np.ndarray, " n"]) -> Int[np.ndarray, " total"]:
    """``starts[i], starts[i] + 1, …`` (``counts[i]`` numbers), one range after the other."""
    ends = np.cumsum(counts)
    return np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts - (ends - counts), counts)


def odd_window(seconds: float, fps: float) -> int:
    """Frames of a centred moving window: ``round(seconds * fps)``, made odd by adding one."""
    return 2 * (int(np.floor(seconds * fps + 0.5 + 1e-9)) // 2) + 1


def moving_sum(values: Float[np.ndarray, "k frames"], batch: MotionBatch, window: int) -> Float[np.ndarray, "k frames"]:
    """Sum over a centred window of frames, with zeros beyond both ends of each sequence."""
    # Shifted sums instead of a cumulative one: their rounding does not depend on the rest of the batch.
    half = window // 2
    spaced_row = np.arange(values.shape[1]) + half * (batch.sequence_of_row + 1)  # zeros keep the sequences apart
    spaced = np.zeros((len(values), values.shape[1] + half * (batch.n_sequences + 1)))
    spaced[:, spaced_row] = values
    width = spaced.shape[1] - 2 * half
    total = spaced[:, :width].copy()
    for shift in range(1, window):
        total += spaced[:, shift : shift + width]
    return total[:, spaced_row - half]


# Value of :attr:`ScoringTargets.hand` where the recording does not say which hand reached.
UNKNOWN_HAND = -1


@dataclass(frozen=True, eq=False)
class GazeRays:
    """Gaze, one ray a frame of the predicted motions, in the same order.

    Attributes:
        origin: Between the eyes, canonical frame, metres.
        direction: Unit vectors, canonical frame.
    """

    origin: Float[np.ndarray, "frames 3"]
    direction: Float[np.ndarray, "frames 3"]
    valid: Bool[np.ndarray, " frames"]

    def rows(self, begin: int, end: int) -> GazeRays:
        """Return the rays of some consecutive frames, without copying."""
        return GazeRays(self.origin[begin:end], self.direction[begin:end], self.valid[begin:end])


@dataclass(frozen=True, eq=False)
class ScoringTargets:
    """The goals of n sequences, all in the canonical frame of their sequence.

    Attributes:
        goal_location: Centre of the object (o_3D), metres.
        prime_time: Recorded prime time, seconds after frame 0 (``prime_time - start_time`` of the table).
        hand: Reaching hand of the recording: 0 left, 1 right, -1 unknown.
        head_tilt_deg: Rest tilt of the neck-head bone of the skeleton that the pose came from.
        fps: Frames per second, one for all or one a sequence.
        gaze: Gaze of the predicted motions: recorded gaze for recorded motion, generated gaze for methods that have it.
        scene: What stands around each sequence and is solid, canonical frames; None where nobody knows.
        pose_given: The method was given the first pose, which is the recorded one.

    Raises:
        ValueError: if goal, prime time, head tilt or frame rate is not finite, or a hand is none of 0, 1 and -1.
    """

    goal_location: Points
    prime_time: Float[np.ndarray, " n"]
    hand: Int[np.ndarray, " n"]
    head_tilt_deg: Float[np.ndarray, " n"]
    fps: float | Float[np.ndarray, " n"]
    gaze: GazeRays | None = None
    scene: Boxes | None = None
    pose_given: bool = True

    def __post_init__(self) -> None:
        columns = {"goal location": self.goal_location, "prime time": self.prime_time, "head tilt": self.head_tilt_deg}
        for name, column in columns.items():
            finite = np.isfinite(column) if column.ndim == 1 else np.isfinite(column).all(axis=1)
            if not finite.all():
                raise ValueError(f"sequence {np.flatnonzero(~finite)[0]}: its {name} is not finite")
        if not (np.isfinite(self.fps).all() and (np.asarray(self.fps) > 0).all()):
            raise ValueError(f"expected positive frame rates, found {self.fps}")
        if not np.isin(self.hand, (UNKNOWN_HAND, 0, 1)).all():
            raise ValueError("expected 0 (left), 1 (right) or -1 (unknown) as hand")

    def __len__(self) -> int:
        return len(self.goal_location)

    @property
    def fps_of_sequence(self) -> Float[np.ndarray, " n"]:
        """Frame rate of each sequence."""
        return np.broadcast_to(np.asarray(self.fps, dtype=np.float64), (len(self),))


@dataclass(frozen=True, eq=False)
class ScoringPair:
    """Predicted and recorded motion of the same sequences with their targets: what a metric family is computed from."""

    predicted: MotionBatch
    recorded: MotionBatch
    targets: ScoringTargets

    @property
    def first_poses(self) -> Float[np.ndarray, "n 22 3"]:
        """The pose that each motion was given to begin with; its own first one where it was given none."""
        motion = self.recorded if self.targets.pose_given else self.predicted
        return motion.values[motion.first].astype(np.float64)

    def part(self, start: int, stop: int) -> ScoringPair:
        """Sequences ``start`` to ``stop - 1``, without copying."""
        targets = self.targets
        gaze = targets.gaze
        if gaze is not None:
            gaze = gaze.rows(int(self.predicted.offsets[start]), int(self.predicted.offsets[stop]))
        scene = None if targets.scene is None else targets.scene.part(start, stop)
        columns = (targets.goal_location, targets.prime_time, targets.hand, targets.head_tilt_deg)
        columns = (column[start:stop] for column in (*columns, targets.fps_of_sequence))
        goal, prime, hand, tilt, fps = columns
        part = ScoringTargets(goal, prime, hand, tilt, fps, gaze, scene, targets.pose_given)
        return ScoringPair(self.predicted.part(start, stop), self.recorded.part(start, stop), part)


def final_reaching_wrist(recorded: MotionBatch, goal_location: Points, hand: Int[np.ndarray, " n"]) -> Points:
    """Return recorded wrist of the reaching hand at the last frame; if unknown, the wrist nearer to the goal there."""
    wrists = recorded.values[recorded.last][:, WRISTS].astype(np.float64)  # (n, 2, 3)
    distance = np.linalg.norm(wrists - goal_location[:, None], axis=-1)
    return wrists[np.arange(len(wrists)), np.where(hand == UNKNOWN_HAND, distance.argmin(axis=1), hand)]
