"""Goals, times and gaze: what a metric needs of each sequence beside the two motions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.geometry.shapes import Boxes
from prbench.geometry.skeleton import WRISTS
from prbench.metrics.batch import MotionBatch

UNKNOWN_HAND = -1
"""Value of :attr:`ScoringTargets.hand` where the recording does not say which hand reached."""


@dataclass(frozen=True, eq=False)
class GazeRays:
    """Gaze, one ray a frame of the predicted motions, in the same order."""

    origin: Float[np.ndarray, "frames 3"]
    """Between the eyes, canonical frame, metres."""
    direction: Float[np.ndarray, "frames 3"]
    """Unit vectors, canonical frame."""
    valid: Bool[np.ndarray, " frames"]

    def rows(self, begin: int, end: int) -> GazeRays:
        """The rays of some consecutive frames, without copying."""
        return GazeRays(self.origin[begin:end], self.direction[begin:end], self.valid[begin:end])


@dataclass(frozen=True, eq=False)
class ScoringTargets:
    """The goals of n sequences, all in the canonical frame of their sequence.

    Raises:
        ValueError: if goal, prime time, head tilt or frame rate is not finite, or a hand is none of 0, 1 and -1.
    """

    goal_location: Float[np.ndarray, "n 3"]
    """Centre of the object (o_3D), metres."""
    prime_time: Float[np.ndarray, " n"]
    """Recorded prime time, seconds after frame 0 (``prime_time - start_time`` of the table)."""
    hand: Int[np.ndarray, " n"]
    """Reaching hand of the recording: 0 left, 1 right, -1 unknown."""
    head_tilt_deg: Float[np.ndarray, " n"]
    """Rest tilt of the neck-head bone of the skeleton that the pose came from."""
    fps: float | Float[np.ndarray, " n"]
    """Frames per second, one for all or one a sequence."""
    gaze: GazeRays | None = None
    """Gaze of the predicted motions: recorded gaze for recorded motion, generated gaze for methods that have it."""
    scene: Boxes | None = None
    """What stands around each sequence and is solid, canonical frames; None where nobody knows."""

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

    def part(self, start: int, stop: int) -> ScoringPair:
        """Sequences ``start`` to ``stop - 1``, without copying."""
        targets = self.targets
        gaze = targets.gaze
        if gaze is not None:
            gaze = gaze.rows(int(self.predicted.offsets[start]), int(self.predicted.offsets[stop]))
        part = ScoringTargets(
            targets.goal_location[start:stop],
            targets.prime_time[start:stop],
            targets.hand[start:stop],
            targets.head_tilt_deg[start:stop],
            targets.fps_of_sequence[start:stop],
            gaze,
            None if targets.scene is None else targets.scene.part(start, stop),
        )
        return ScoringPair(self.predicted.part(start, stop), self.recorded.part(start, stop), part)


def final_reaching_wrist(
    recorded: MotionBatch, goal_location: Float[np.ndarray, "n 3"], hand: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Recorded wrist of the reaching hand at the last frame; if unknown, the wrist nearer to the goal there."""
    wrists = recorded.values[recorded.last][:, WRISTS].astype(np.float64)  # (n, 2, 3)
    distance = np.linalg.norm(wrists - goal_location[:, None], axis=-1)
    side = np.where(hand == UNKNOWN_HAND, distance.argmin(axis=1), hand)
    return wrists[np.arange(len(wrists)), side]
