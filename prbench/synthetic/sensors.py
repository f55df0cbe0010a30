"""Sensor errors: switches, the random stream of each, and the measurements that several datasets have in common.

Sources: docs/specification/synthetic-recordings.md#sensors and
docs/specification/synthetic-recordings.md#determinism-splits-sizes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.geometry.timelines import interpolate, slerp
from prbench.readers.aria_mps.format import gaze_angles
from prbench.synthetic.people.world import Source
from prbench.synthetic.performance import ObjectMotion, Performance

Points = Float[np.ndarray, "n 3"]  # metres, or unit directions

_DEVICE_START = (100.0, 60_000.0)  # s, device time of the first frame
_BLINKS_A_MINUTE = 15.0
_BLINK = 0.15  # s


@dataclass(frozen=True)
class Switches:
    """Which errors are on. Every error draws from a stream of its own, so none changes what another one draws.

    Attributes:
        pose_noise: White noise of the glasses' poses.
        pose_drift: Slow errors of the world that the glasses' poses were estimated in (not ADT, whose rooms are
            surveyed).
        pose_clock: Uneven steps of the 1 kHz poses.
        pose_losses: Poses of quality 0.
        gaze_bias: A constant angle a recording.
        gaze_losses: Missing gaze rows.
        blinks: Gaze rows without angles.
        gaze_clock: Time stamps of gaze off by some microseconds.
        body_noise: White noise of the suit's joints.
        body_wobble: Slow shifts of the suit's segments.
        body_losses: Frames at the origin or with a joint thrown off, and occluded markers.
        hand_noise: White noise of tracked hands.
        hand_losses: Hands out of view are missing, and of low confidence towards its edge.
        hand_start: Hands of the first 0.7 s are wrong in one recording of five (HOT3D).
        object_gaps: Runs of missing rows of objects (HOT3D).
        clock_drift: The clock of the ground truth runs up to 1 ppm faster or slower than the glasses' (HOT3D).
        limb_wobble: Elbows, knees and wrists of an estimated body (EgoAllo) wander.
        foot_slip: Feet of an estimated body slide.
        root_height: Every window of an estimated body stands too high or too low.
        video_clock: Video frames whose image is shown twice or skipped.
        annotated_times: Starts and ends of movements as people mark them.
        annotated_points: Places of objects as lifted from depth.
        mask_losses: Events without a mask, so without a place.
    """

    pose_noise: bool = True
    pose_drift: bool = True
    pose_clock: bool = True
    pose_losses: bool = True
    gaze_bias: bool = True
    gaze_jitter: bool = True
    gaze_losses: bool = True
    blinks: bool = True
    gaze_clock: bool = True
    body_noise: bool = True
    body_wobble: bool = True
    body_losses: bool = True
    object_noise: bool = True
    hand_noise: bool = True
    hand_losses: bool = True
    hand_start: bool = True
    object_gaps: bool = True
    clock_drift: bool = True
    limb_wobble: bool = True
    foot_slip: bool = True
    root_height: bool = True
    video_clock: bool = True
    annotated_times: bool = True
    annotated_points: bool = True
    mask_losses: bool = True

    @classmethod
    def ideal(cls) -> Switches:
        """Switch every error off: readings are the truth, rounded."""
        return cls(**dict.fromkeys((field.name for field in fields(cls)), False))


@dataclass(frozen=True)
class Sensing:
    """A performance together with how wrongly its sensors measure it.

    Attributes:
        noise: Multiplies every error: its size, or how often it happens; 0 for ideal sensors.
    """

    performance: Performance
    noise: float
    switches: Switches

    def generator(self, purpose: str) -> np.random.Generator:
        """Return the random stream of one purpose (see :func:`sensor_generator`)."""
        return sensor_generator(self.performance, purpose)

    def strength(self, error: str) -> float:
        """Return the factor on the size (or probability) of an error: the noise level, or 0 where it is off.

        Args:
            error: Name of a field of :class:`Switches`.
        """
        return self.noise if getattr(self.switches, error) else 0.0

    def times(self, rate: float) -> Float[np.ndarray, " n"]:
        """Return the instants of a sensor of a steady rate, performance seconds, from the first to the last frame."""
        # Without the nanosecond, rounding would cost the last frame of a duration that is a multiple of the period.
        return self.performance.times[0] + np.arange(int((self.performance.duration + 1e-9) * rate) + 1) / rate

    def head(self, times: Float[np.ndarray, " n"]) -> Rotation:
        """Return the true orientation of the head (x left, y up, z forward) in the performance's world."""
        turned = slerp(self.performance.times, self.performance.head_rotation, times)
        return Rotation.from_quat(turned, scalar_first=True)

    def eye(self, times: Float[np.ndarray, " n"]) -> Points:
        """Return the true eye positions, metres."""
        return interpolate(self.performance.times, self.performance.eye, times)

    def gaze(self, times: Float[np.ndarray, " n"]) -> Points:
        """Return the true gaze directions; between frames a little shorter than 1."""
        return interpolate(self.performance.times, self.performance.gaze, times)


def sensor_generator(performance: Performance, purpose: str) -> np.random.Generator:
    """Return the random stream of one purpose of one recording, independent of all others."""
    source = Source(performance.seed, performance.preset, performance.world)
    return source.generator("recording", performance.index, purpose)


def device_start_us(performance: Performance) -> int:
    """Return the device time of the performance's first instant, microseconds.

    Device seconds = performance seconds - ``performance.times[0]`` + this / 1e6: what turns the truth's times into
    those of the recording.
    """
    return round(sensor_generator(performance, "clock").uniform(*_DEVICE_START) * 1e6)


def gaze_bias_of(sensing: Sensing, size: float) -> tuple[float, float]:
    """Draw the recording's constant gaze error, yaw and pitch, radians; ``size`` is its deviation an axis."""
    yaw, pitch = sensing.generator("gaze-bias").normal(0.0, size, 2) * sensing.strength("gaze_bias")
    return float(yaw), float(pitch)


def measured_gaze(
    sensing: Sensing, head: Rotation, gaze: Points, *, bias: float, jitter: float
) -> Float[np.ndarray, "n 2"]:
    """Return yaw and pitch of the gaze in the head, radians, with constant error and jitter.

    Args:
        sensing: The truth and its errors.
        head: Orientation of the head at each instant.
        gaze: True directions at the same instants, world.
        bias: Deviation of the constant error, radians an axis.
        jitter: Deviation of the white noise, radians an axis.
    """
    angles = np.column_stack(gaze_angles(head.inv().apply(gaze)))
    angles += gaze_bias_of(sensing, bias)
    angles += sensing.generator("gaze-jitter").normal(0.0, jitter, angles.shape) * sensing.strength("gaze_jitter")
    return angles


def closed_eyes(sensing: Sensing, times: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return the instants at which the wearer blinks."""
    rng = sensing.generator("blinks")
    starts = rng.uniform(times[0], times[-1], rng.poisson(_BLINKS_A_MINUTE / 60.0 * sensing.performance.duration))
    closed = np.minimum(_BLINK * sensing.strength("blinks"), 1.0)
    return ((times >= starts[:, None]) & (times < starts[:, None] + closed)).any(axis=0)


def fixation_depth(sensing: Sensing, times: Float[np.ndarray, " n"], otherwise: float) -> Float[np.ndarray, " n"]:
    """Return the distance from the eyes to the point fixated, metres; ``otherwise`` between fixations."""
    depth = np.full(len(times), otherwise)
    eye = sensing.eye(times)
    for look in sensing.performance.fixations:
        rows = slice(*np.searchsorted(times, (look.start, look.end)))
        depth[rows] = np.linalg.norm(look.target - eye[rows], axis=1)
    return depth


def tracked(
    sensing: Sensing, name: str, position: Points, rotation: Rotation, *, size: tuple[float, float], scale: float
) -> tuple[Points, Rotation]:
    """Return the poses of an object with the white noise of its tracking.

    Args:
        sensing: Names the random stream.
        name: Name of the object; each has a stream of its own, so that one object more changes no other.
        position: True positions, metres.
        rotation: True orientations.
        size: Deviations of position, metres, and of rotation, radians, an axis.
        scale: Multiplies both.
    """
    rng = sensing.generator(f"object-noise-{name}")
    moved = position + rng.normal(0.0, size[0], position.shape) * scale
    return moved, rotation * Rotation.from_rotvec(rng.normal(0.0, size[1], position.shape) * scale)


def untracked(performance: Performance, motion: ObjectMotion, times: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Return the instants of ``lost`` events, at which nobody sees the object."""
    spans = [event.lost_span for event in performance.events if event.object_id == motion.object_id and event.lost_span]
    return within(times, np.array(spans).reshape(-1, 2))


def within(times: Float[np.ndarray, " n"], spans: Float[np.ndarray, "k 2"]) -> Bool[np.ndarray, " n"]:
    """Return the instants inside any of the spans, ends included."""
    return np.asarray(((times >= spans[:, :1]) & (times <= spans[:, 1:])).any(axis=0))
