"""The array operations of which every movement is made: blends, wobbles, turned vectors, two-bone limbs, quaternions.

Source: docs/specification/synthetic-recordings.md, conventions. Angles are radians: yaw about +Y (0 faces +Z, positive
turns left), pitch > 0 looks or leans down, and R = Ry(yaw) Rx(pitch). Everything works on all frames at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

Signal = Float[np.ndarray, " n"]  # one number a time
Channel = Float[np.ndarray, "n *dims"]  # one number or vector a time
Points = Float[np.ndarray, "n 3"]  # metres
Angle = np.ndarray | float  # radians, one or one a time

UP = np.array([0.0, 1.0, 0.0])


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
    channel: Channel,
    times: Signal,
    start: float,
    duration: float,
    target: np.ndarray | float,
    *,
    shape: Callable[[np.ndarray], np.ndarray] = minimum_jerk,
) -> None:
    """Make a channel take up a target from ``start`` on, within ``duration``, in place.

    Args:
        channel: The channel; from ``start`` on it moves to, and after ``duration`` equals, the target.
        times: Frame times, seconds, increasing.
        start: First instant of the blend.
        duration: Seconds until the target is reached.
        target: A constant (broadcast over frames), or one value a frame of the whole recording.
        shape: Takes shares of the duration to shares of the way.
    """
    first, last = np.searchsorted(times, [start, start + duration])
    target = np.asarray(target, dtype=np.float64)
    moving = target.ndim == channel.ndim and target.shape[0] == times.shape[0]
    progress = shape((times[first:last] - start) / duration)
    progress = progress.reshape(-1, *([1] * (channel.ndim - 1)))
    channel[first:last] += progress * ((target[first:last] if moving else target) - channel[first:last])
    channel[last:] = target[last:] if moving else target


def add_bump(channel: Channel, times: Signal, start: float, duration: float, height: np.ndarray | float) -> None:
    """Add a smooth hump that is zero at ``start`` and at ``start + duration``, in place."""
    first, last = np.searchsorted(times, [start, start + duration])
    shape = bump((times[first:last] - start) / duration).reshape(-1, *([1] * (channel.ndim - 1)))
    channel[first:last] += shape * np.asarray(height)


def wobble(times: Signal, rms: float, low: float, high: float, rng: np.random.Generator) -> Signal:
    """Return a sum of five sines of random phase, with frequencies from ``low`` to ``high`` Hz and the given r.m.s."""
    frequencies = rng.uniform(low, high, 5)
    waves = np.sin(2.0 * np.pi * frequencies[:, None] * times + rng.uniform(0.0, 2.0 * np.pi, 5)[:, None])
    # A sine of amplitude 1 has the mean square 1/2, and five independent ones 5/2.
    return rms * np.sqrt(2.0 / 5.0) * waves.sum(axis=0)


def smooth(values: Channel, seconds: float, rate: float) -> np.ndarray:
    """Apply a Gaussian filter over frames whose standard deviation is ``seconds``."""
    return gaussian_filter1d(values, seconds * rate, axis=0, mode="nearest", truncate=3.0)


def two_pole_low_pass(values: Signal, time_constant: float, rate: float) -> np.ndarray:
    """Apply two equal exponential filters in series, at rest on the first value."""
    decay = float(np.exp(-1.0 / (time_constant * rate)))
    for _ in range(2):
        # Apply one exponential filter, at rest on the first value.
        filtered = np.empty(len(values))
        kept = decay * float(values[0])
        gain = 1.0 - decay
        for index, value in enumerate(values.tolist()):
            output = kept + gain * value
            filtered[index] = output
            kept = decay * output
        values = filtered
    return values


def wrap(angle: Angle) -> np.ndarray:
    """Wrap an angle to [-pi, pi)."""
    return np.asarray((np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi)


def turn(yaw: Angle, pitch: Angle, vector: np.ndarray) -> np.ndarray:
    """Apply Ry(yaw) Rx(pitch) to a vector; all arguments broadcast over the leading axes."""
    x = vector[..., 0]
    y = vector[..., 1]
    z = vector[..., 2]
    cos_pitch = np.cos(pitch)
    sin_pitch = np.sin(pitch)
    tipped_y = y * cos_pitch - z * sin_pitch
    tipped_z = y * sin_pitch + z * cos_pitch
    cos_yaw = np.cos(yaw)
    sin_yaw = np.sin(yaw)
    turned_x = x * cos_yaw + tipped_z * sin_yaw
    turned = np.empty((*np.broadcast_shapes(np.shape(turned_x), np.shape(tipped_y)), 3))
    turned[..., 0], turned[..., 1], turned[..., 2] = turned_x, tipped_y, tipped_z * cos_yaw - x * sin_yaw
    return turned


def rotation(yaw: Angle, pitch: Angle) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the matrix Ry(yaw) Rx(pitch); its columns are left, up and forward of the turned frame."""
    return np.stack([turn(yaw, pitch, axis) for axis in np.eye(3)], axis=-1)


def rotation_quaternion(yaw: np.ndarray, pitch: np.ndarray) -> Float[np.ndarray, "*batch 4"]:
    """Return the quaternion (w x y z) of Ry(yaw) Rx(pitch), w >= 0."""
    cos_yaw, sin_yaw, cos_pitch, sin_pitch = (f(angle / 2.0) for angle in (yaw, pitch) for f in (np.cos, np.sin))
    turned = np.stack([cos_yaw * cos_pitch, cos_yaw * sin_pitch, sin_yaw * cos_pitch, -sin_yaw * sin_pitch], axis=-1)
    return np.where(turned[..., :1] < 0.0, -turned, turned)


def direction(yaw: Angle, pitch: Angle) -> np.ndarray:
    """Return the unit vector that looks along yaw and pitch."""
    cos_pitch = np.cos(pitch)
    return np.stack(np.broadcast_arrays(np.sin(yaw) * cos_pitch, -np.sin(pitch), np.cos(yaw) * cos_pitch), axis=-1)


def yaw_and_pitch(vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the yaw and pitch of a direction; inverse of :func:`direction` up to full turns."""
    x = vector[..., 0]
    y = vector[..., 1]
    z = vector[..., 2]
    return np.asarray(np.arctan2(x, z)), np.asarray(-np.arctan2(y, np.hypot(x, z)))


def unit(vector: np.ndarray) -> np.ndarray:
    """Divide a vector by its length."""
    return vector / np.sqrt(np.einsum("...i,...i->...", vector, vector))[..., None]


def orthogonal_unit(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the unit part of ``vector`` orthogonal to the unit vector ``axis``."""
    return unit(vector - np.einsum("...i,...i->...", vector, axis)[..., None] * axis)


def soft_limit(ratio: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Return the ratio itself up to ``begin``, then a number that nears ``end`` smoothly without reaching it."""
    width = end - begin
    return np.where(ratio > begin, begin + width * np.tanh((ratio - begin) / width), ratio)


def two_bone(
    root: Points, target: Points, lengths: tuple[float, float], pole: Points, limit: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and end joint of a limb that reaches from ``root`` towards ``target`` and bends towards ``pole``.

    Args:
        root: Hip or shoulder.
        target: Wanted ankle or wrist.
        lengths: Upper and lower bone.
        pole: Direction into which the middle joint points; need not be unit or orthogonal.
        limit: Extension (distance over limb length) at which the soft limit begins, and its end below 1.

    Returns:
        Knee or elbow, and the ankle or wrist at the softly limited distance.
    """
    upper, lower = lengths
    offset = target - root
    wanted = np.sqrt(np.einsum("...i,...i->...", offset, offset))
    along = offset / wanted[..., None]
    distance = soft_limit(wanted / (upper + lower), *limit) * (upper + lower)
    # Law of cosines: the angle at the root between the upper bone and the line to the target.
    cosine = np.clip((upper**2 + distance**2 - lower**2) / (2.0 * upper * distance), -1.0, 1.0)
    across = orthogonal_unit(pole, along)
    middle = root + upper * (cosine[..., None] * along + np.sqrt(1.0 - cosine**2)[..., None] * across)
    return middle, root + distance[..., None] * along


def frame_of_bone(along: np.ndarray, hinge: np.ndarray) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotation whose y axis lies along a bone and whose x axis is as near to ``hinge`` as possible."""
    y = unit(along)
    x = orthogonal_unit(hinge, y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def quaternion(matrix: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 4"]:
    """Return the quaternions (w x y z) of rotation matrices; w >= 0 up to rounding."""
    m = matrix
    diagonal = (m[..., 0, 0], m[..., 1, 1], m[..., 2, 2])
    trace = diagonal[0] + diagonal[1] + diagonal[2]
    squares = [1.0 + trace, *(1.0 + 2.0 * entry - trace for entry in diagonal)]
    wx = m[..., 2, 1] - m[..., 1, 2]
    wy = m[..., 0, 2] - m[..., 2, 0]
    wz = m[..., 1, 0] - m[..., 0, 1]
    xy = m[..., 0, 1] + m[..., 1, 0]
    xz = m[..., 0, 2] + m[..., 2, 0]
    yz = m[..., 1, 2] + m[..., 2, 1]
    w2, x2, y2, z2 = squares
    rows = ((w2, wx, wy, wz), (wx, x2, xy, xz), (wy, xy, y2, yz), (wz, xz, yz, z2))
    candidates = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    # Any row is the quaternion times a number; the one with the largest component loses no digits (Shepperd, 1978).
    best = np.stack(squares, axis=-1).argmax(axis=-1)
    chosen = unit(np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :])
    return np.where(chosen[..., :1] < 0.0, -chosen, chosen)


def forward_of(quaternions: Float[np.ndarray, "*batch 4"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the forward axes (z) of the frames that unit quaternions (w x y z) turn."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
