"""Foot Skating after Guided Motion Diffusion, and the share of frames in which it can happen at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import TOES
from prbench.metrics.batch import MotionBatch, ScoringPair, moving_sum, odd_window
from prbench.metrics.registry import MetricFamily, MetricValues, detail, headline
from prbench.protocol.manifests import MetricConstants

Fps = float | Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class ToeSteps:
    """The steps of both toes from each frame to the next; a sequence's last frame has none and holds zeros.

    Attributes:
        speed: Horizontal, m/s.
        averaged_speed: Moving average of ``speed`` with zeros beyond both ends.
        contact: Toe below ``foot_height`` before and after the step.
    """

    speed: Float[np.ndarray, "2 frames"]
    averaged_speed: Float[np.ndarray, "2 frames"]
    contact: Bool[np.ndarray, "2 frames"]


def foot_skating(motion: MotionBatch, fps: Fps, constants: MetricConstants) -> Float[np.ndarray, " n"]:
    """Share of frame transitions in which a toe slides over the floor (docs/specification/metrics.md#foot-skating).

    A toe slides if it stays below ``foot_height`` while both its horizontal speed and the moving average of that speed
    exceed ``foot_speed``. Heights are absolute: the floor is Y = 0.

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second.
        constants: Thresholds of the protocol; ``foot_window`` is 5 frames at 20 fps and another odd number elsewhere.
    """
    return _share_of_transitions(_sliding(toe_steps(motion, fps, constants), constants), motion)


def contact_share(motion: MotionBatch, constants: MetricConstants) -> Float[np.ndarray, " n"]:
    """Share of frame transitions in which a toe stays below ``foot_height``; where it is 0, nothing can skate."""
    return _share_of_transitions(toe_steps(motion, 1.0, constants).contact, motion)


def slow_slides(motion: MotionBatch, fps: Fps, constants: MetricConstants) -> Float[np.ndarray, " n"]:
    """Share of frame transitions in which a toe that stays below ``foot_height`` moves faster than ``slide_speed``.

    No average damps it, and its limit lies below that of Foot Skating, which a body that glides slowly does not reach
    (docs/specification/metrics.md#slow-slides).

    Args:
        motion: Canonical frame, metres, two frames or more.
        fps: Frames per second.
        constants: Thresholds of the protocol, in metres, seconds and degrees.
    """
    steps = toe_steps(motion, fps, constants)
    sliding = steps.contact & (steps.speed > constants.slide_speed + constants.foot_tolerance)
    return _share_of_transitions(sliding, motion)


def toe_steps(motion: MotionBatch, fps: Fps, constants: MetricConstants) -> ToeSteps:
    """Speeds and contacts of the toe joints (``TOES``).

    Raises:
        ValueError: if a sequence has fewer than two frames.
    """
    motion.require_frames(2)
    fps_of_sequence = np.broadcast_to(np.asarray(fps, dtype=np.float64), (motion.n_sequences,))
    speed = np.zeros((len(TOES), len(motion.values)))
    for toe, track in zip(speed, motion.columns[list(TOES)], strict=True):
        toe[:-1] = np.sqrt(np.diff(track[0]) ** 2 + np.diff(track[2]) ** 2)
    # One difference over the whole array is fast; the steps from one sequence to the next are set to 0 below.
    speed *= fps_of_sequence[motion.sequence_of_row]
    speed[:, motion.last] = 0.0
    windows = np.array([odd_window(constants.foot_window, rate) for rate in np.unique(fps_of_sequence)])
    window_of_sequence = windows[np.searchsorted(np.unique(fps_of_sequence), fps_of_sequence)]
    averaged = np.empty_like(speed)
    for window in np.unique(windows):
        rows = (window_of_sequence == window)[motion.sequence_of_row]
        averaged[:, rows] = moving_sum(speed, motion, int(window))[:, rows] / window
    low = motion.columns[list(TOES), 1] < constants.foot_height - constants.foot_tolerance
    # A step is a contact only if the toe is low before and after it.
    contact = np.zeros_like(low)
    contact[:, :-1] = low[:, :-1] & low[:, 1:]
    contact[:, motion.last] = False
    return ToeSteps(speed, averaged, contact)


def _sliding(steps: ToeSteps, constants: MetricConstants) -> np.ndarray:
    limit = constants.foot_speed + constants.foot_tolerance
    return steps.contact & (steps.speed > limit) & (steps.averaged_speed > limit)


def _share_of_transitions(of_toes: np.ndarray, motion: MotionBatch) -> np.ndarray:
    motion.require_frames(2)
    return np.add.reduceat((of_toes[0] | of_toes[1]).astype(np.int64), motion.first) / (motion.n_frames - 1)


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, MetricValues]:
    motion = pair.predicted
    steps = toe_steps(motion, pair.targets.fps, constants)
    sliding = _share_of_transitions(_sliding(steps, constants), motion)
    contact = _share_of_transitions(steps.contact, motion)
    return MetricValues("foot_skating", sliding, {}), MetricValues("contact_share", contact, {})


_SKATING = {"higher_is_better": False, "in_study": True, "irrelevant_if_motionless": True}
_METRICS = (
    headline("foot_skating", "Foot Skating", "ratio", 7, **_SKATING),
    detail("contact_share", "Foot contact", "ratio", 17, higher_is_better=None),
)
FAMILY = MetricFamily(_METRICS, _compute)
