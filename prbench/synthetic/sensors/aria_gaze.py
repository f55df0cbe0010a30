"""Errors of the gaze of Aria glasses, for ADT and the Machine Perception Services alike.

Source: docs/specification/synthetic-recordings.md#sensors.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.readers.aria_mps.format import GazeKind, gaze_angles
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors.errors import Switches, sensor_generator, strength
from prbench.timelines import interpolate, slerp

GAZE_MARGIN = 0.02
"""Radians, half of the written uncertainty interval."""
_GAZE_BIAS, _GAZE_JITTER = np.deg2rad(1.0) / np.sqrt(2), np.deg2rad(0.5)
_GENERAL = 2.5  # how much larger the bias is without the wearer's own calibration
_GAZE_LOSS = 0.03
_GAZE_CLOCK_US = 16
_BLINKS_A_MINUTE, _BLINK = 15.0, 0.15  # s


def gaze_bias(
    performance: Performance, *, noise: float, switches: Switches, gaze_kind: GazeKind = "personalized"
) -> tuple[float, float]:
    """The recording's constant gaze error, yaw and pitch, radians."""
    size = _GAZE_BIAS * (_GENERAL if gaze_kind == "general" else 1.0)
    bias = sensor_generator(performance, "gaze-bias").normal(0.0, size, 2)
    yaw, pitch = bias * strength(switches.gaze_bias, noise)
    return float(yaw), float(pitch)


def gaze_measurements(
    performance: Performance,
    times: Float[np.ndarray, " n"],
    *,
    noise: float,
    switches: Switches,
    gaze_kind: GazeKind = "personalized",
) -> Float[np.ndarray, "n 2"]:
    """Yaw and pitch with bias and jitter, radians; NaN while the eyes are closed.

    Args:
        performance: The truth.
        times: When the eyes are looked at, performance seconds.
        noise: Multiplies every error.
        switches: Which errors are on.
        gaze_kind: Without the wearer's own calibration the bias is larger.
    """
    head = Rotation.from_quat(slerp(performance.times, performance.head_rotation, times), scalar_first=True)
    angles = np.column_stack(gaze_angles(head.inv().apply(interpolate(performance.times, performance.gaze, times))))
    angles += gaze_bias(performance, noise=noise, switches=switches, gaze_kind=gaze_kind)
    jitter = sensor_generator(performance, "gaze-jitter").normal(0.0, _GAZE_JITTER, (len(times), 2))
    angles += jitter * strength(switches.gaze_jitter, noise)
    angles[_blinks(performance, times, strength(switches.blinks, noise))] = np.nan
    return angles


def lost_gaze(performance: Performance, n: int, *, noise: float, switches: Switches) -> Bool[np.ndarray, " n"]:
    """Rows that the files lack."""
    share = _GAZE_LOSS * strength(switches.gaze_losses, noise)
    return np.asarray(sensor_generator(performance, "gaze-losses").random(n) < share)


def gaze_clock_us(performance: Performance, n: int, *, noise: float, switches: Switches) -> Int[np.ndarray, " n"]:
    """Errors of the time stamps, microseconds."""
    shift = sensor_generator(performance, "gaze-clock").uniform(-_GAZE_CLOCK_US, _GAZE_CLOCK_US, n)
    return np.rint(shift * strength(switches.gaze_clock, noise)).astype(np.int64)


def _blinks(performance: Performance, times: Float[np.ndarray, " n"], scale: float) -> Bool[np.ndarray, " n"]:
    rng = sensor_generator(performance, "blinks")
    count = rng.poisson(_BLINKS_A_MINUTE / 60.0 * performance.duration)
    starts = rng.uniform(times[0], times[-1], count)
    closed = np.minimum(_BLINK * scale, 1.0)
    return ((times >= starts[:, None]) & (times < starts[:, None] + closed)).any(axis=0)
