"""Sensor errors: switches, and the random stream of each.

Sources: docs/specification/synthetic-recordings.md#sensors and
docs/specification/synthetic-recordings.md#determinism-splits-sizes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from prbench.randomness import named_generator
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.performance import Performance


@dataclass(frozen=True)
class Switches:
    """Which errors are on. Every error draws from a stream of its own, so none changes what another one draws."""

    pose_noise: bool = True
    """White noise of the glasses' poses."""
    pose_drift: bool = True
    """Slow errors of the world that the glasses' poses were estimated in (not ADT, whose rooms are surveyed)."""
    pose_clock: bool = True
    """Uneven steps of the 1 kHz poses."""
    pose_losses: bool = True
    """Poses of quality 0."""
    gaze_bias: bool = True
    """A constant angle a recording."""
    gaze_jitter: bool = True
    gaze_losses: bool = True
    """Missing gaze rows."""
    blinks: bool = True
    """Gaze rows without angles."""
    gaze_clock: bool = True
    """Time stamps of gaze off by some microseconds."""
    body_noise: bool = True
    """White noise of the suit's joints."""
    body_wobble: bool = True
    """Slow shifts of the suit's segments."""
    body_losses: bool = True
    """Frames at the origin or with a joint thrown off, and occluded markers."""
    object_noise: bool = True
    hand_noise: bool = True
    """White noise of tracked hands."""
    hand_losses: bool = True
    """Hands out of view are missing, and of low confidence towards its edge."""
    hand_start: bool = True
    """Hands of the first 0.7 s are wrong in one recording of five (HOT3D)."""
    object_gaps: bool = True
    """Runs of missing rows of objects (HOT3D)."""
    clock_drift: bool = True
    """The clock of the ground truth runs up to 1 ppm faster or slower than the glasses' (HOT3D)."""
    limb_wobble: bool = True
    """Elbows, knees and wrists of an estimated body (EgoAllo) wander."""
    foot_slip: bool = True
    """Feet of an estimated body slide."""
    root_height: bool = True
    """Every window of an estimated body stands too high or too low."""
    video_clock: bool = True
    """Video frames whose image is shown twice or skipped."""
    annotated_times: bool = True
    """Starts and ends of movements as people mark them."""
    annotated_points: bool = True
    """Places of objects as lifted from depth."""
    mask_losses: bool = True
    """Events without a mask, so without a place."""

    @classmethod
    def ideal(cls) -> Switches:
        """Switch every error off: readings are the truth, rounded."""
        return cls(**dict.fromkeys((field.name for field in fields(cls)), False))


def sensor_generator(performance: Performance, purpose: str) -> np.random.Generator:
    """Return the random stream of one purpose of one recording, independent of all others."""
    return named_generator(
        "prbench-synth",
        GENERATOR_VERSION,
        performance.seed,
        performance.preset,
        performance.world,
        "recording",
        performance.index,
        purpose,
    )


def strength(switch: bool, noise: float) -> float:
    """Return the factor on the size (or probability) of an error: the noise level, or 0 where it is off."""
    return noise if switch else 0.0
