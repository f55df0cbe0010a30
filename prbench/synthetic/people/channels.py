"""The two idioms of which every movement is made: blends towards moving targets, and wobbles.

Both are array operations over frames; source: docs/specification/synthetic-recordings.md, conventions.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter


def minimum_jerk(x: np.ndarray | float) -> np.ndarray:
    """Return 10 x^3 - 15 x^4 + 6 x^5 with x clipped to [0, 1]."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def _minimum_jerk_integral(x: np.ndarray | float) -> np.ndarray:
    """Return the integral of :func:`minimum_jerk` from 0 to x; 0.5 at x = 1 and a straight line after it."""
    inside = np.clip(x, 0.0, 1.0)
    return inside**4 * (2.5 + inside * (inside - 3.0)) + np.maximum(x - 1.0, 0.0)


def bump(x: np.ndarray | float) -> np.ndarray:
    """Return 16 m^2 (1 - m)^2 of the minimum-jerk progress m: 0 at both ends, 1 in the middle."""
    progress = minimum_jerk(x)
    return 16.0 * progress**2 * (1.0 - progress) ** 2


def eased_trapezoid(x: np.ndarray, up: float, down: float) -> np.ndarray:
    """Return the progress of a speed that rises over ``up``, is constant, and falls over ``down`` (shares of time)."""
    x = np.clip(x, 0.0, 1.0)
    rising = up * _minimum_jerk_integral(x / up)
    falling = down * _minimum_jerk_integral((x - (1.0 - down)) / down) * (x > 1.0 - down)
    return (rising - falling) / (1.0 - 0.5 * up - 0.5 * down)


def blend(
    channel: Float[np.ndarray, "n *dims"],
    times: Float[np.ndarray, " n"],
    start: float,
    duration: float,
    target: np.ndarray | float,
) -> None:
    """Make a channel take up a target from ``start`` on, within ``duration``, in place.

    Args:
        channel: The channel; from ``start`` on it moves to, and after ``duration`` equals, the target.
        times: Frame times, seconds, increasing.
        start: First instant of the blend.
        duration: Seconds until the target is reached.
        target: A constant (broadcast over frames), or one value a frame of the whole recording.
    """
    first, last = np.searchsorted(times, [start, start + duration])
    target = np.asarray(target, dtype=np.float64)
    moving = target.ndim == channel.ndim and target.shape[0] == times.shape[0]
    progress = minimum_jerk((times[first:last] - start) / duration)
    progress = progress.reshape(-1, *([1] * (channel.ndim - 1)))
    channel[first:last] += progress * ((target[first:last] if moving else target) - channel[first:last])
    channel[last:] = target[last:] if moving else target


def add_bump(
    channel: Float[np.ndarray, "n *dims"],
    times: Float[np.ndarray, " n"],
    start: float,
    duration: float,
    height: np.ndarray | float,
) -> None:
    """Add a smooth hump that is zero at ``start`` and at ``start + duration``, in place."""
    first, last = np.searchsorted(times, [start, start + duration])
    shape = bump((times[first:last] - start) / duration).reshape(-1, *([1] * (channel.ndim - 1)))
    channel[first:last] += shape * np.asarray(height)


def wobble(
    times: Float[np.ndarray, " n"], rms: float, low: float, high: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Return a sum of five sines of random phase, with frequencies from ``low`` to ``high`` Hz and the given r.m.s."""
    frequencies = rng.uniform(low, high, 5)
    phases = rng.uniform(0.0, 2.0 * np.pi, 5)
    waves = np.sin(2.0 * np.pi * frequencies[:, None] * times + phases[:, None])
    return rms * np.sqrt(2.0 / 5.0) * waves.sum(axis=0)


def smooth(values: Float[np.ndarray, "n *dims"], seconds: float, rate: float) -> np.ndarray:
    """Apply a Gaussian filter over frames whose standard deviation is ``seconds``."""
    return gaussian_filter1d(values, seconds * rate, axis=0, mode="nearest", truncate=3.0)


def two_pole_low_pass(values: Float[np.ndarray, " n"], time_constant: float, rate: float) -> np.ndarray:
    """Apply two equal exponential filters in series, at rest on the first value."""
    decay = np.exp(-1.0 / (time_constant * rate))
    for _ in range(2):
        values = lfilter([1.0 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0]
    return values


def wrap(angle: np.ndarray | float) -> np.ndarray:
    """Wrap an angle to [-pi, pi)."""
    return np.asarray((np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi)
