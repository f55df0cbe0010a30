"""Where an object rests before or after a movement, and the instant at which it leaves that rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.timelines import interpolate

_LONGEST_REST = 1.0  # seconds of rest that are averaged: enough to suppress sensor noise, short enough to be local


@dataclass(frozen=True)
class Departure:
    """An object leaves its rest (or, seen backwards in time, comes to rest)."""

    time: float
    """When the movement begins, seconds: see :func:`find_departure`."""
    gap: tuple[float, float]
    """Times of the last sample at rest and of the first away from it, seconds."""
    first_away: Float[np.ndarray, "3"]
    """Centre of the box at the latter."""
    centre: Float[np.ndarray, "3"]
    """Median centre of the box during the rest."""
    position: Float[np.ndarray, "3"]
    """Median position of the object's origin during the rest."""
    rotation: Float[np.ndarray, "4"]
    """Mean orientation of the rest, w x y z."""

    placed: bool = True
    """False where the object was not tracked in the gap, and nothing tells when in it the movement began."""

    def reversed(self) -> Departure:
        """The same with time running backwards."""
        return replace(self, time=-self.time, gap=(-self.gap[0], -self.gap[1]))


@dataclass(frozen=True)
class Track:
    """The valid samples of one object: times, centre of the box, pose, and how fast the centre moves."""

    times: Float[np.ndarray, " n"]
    centre: Float[np.ndarray, "n 3"]
    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    speed: Float[np.ndarray, " n"]
    window: float
    """Over which ``speed`` is measured, seconds."""

    def reversed(self) -> Track:
        """The same with time running backwards."""
        return Track(
            -self.times[::-1],
            self.centre[::-1],
            self.position[::-1],
            self.rotation[::-1],
            self.speed[::-1],
            self.window,
        )


def windowed_speed(
    times: Float[np.ndarray, " n"], points: Float[np.ndarray, "n 3"], *, window: float
) -> Float[np.ndarray, " n"]:
    """Distance covered within a centred window over its length, m/s; at the ends the window is cut.

    The chord, not the path: noise of the samples does not add up.
    """
    if len(times) < 2:
        return np.zeros(len(times))
    before = np.maximum(times - window / 2, times[0])
    after = np.minimum(times + window / 2, times[-1])
    chord = interpolate(times, points, after) - interpolate(times, points, before)
    return np.linalg.norm(chord, axis=1) / (after - before)


def find_departure(
    track: Track, still: Bool[np.ndarray, " n"], start: int, stop: int, *, floor: int, tolerance: float
) -> Departure | None:
    """The last rest before a holding, and the instant at which the object leaves it.

    From the start of the holding the search goes back to the last ``still`` sample; the still run that ends there is
    the rest. The boundary is the last crossing of ``tolerance`` on the way out, so that single noisy samples during
    the rest move nothing. Where the object creeps away, that crossing comes late: the time is therefore extrapolated
    back by as long as it takes from ``tolerance`` to twice that (exact for a steady departure; a smooth one that grows
    with the cube of time is then 0.4 tolerances away), at most by half of the speed's window.
    For the rest *after* a holding call this with everything reversed.

    Args:
        track: The object's samples.
        still: Samples at which it moves slowly, or not at all.
        start: First sample of the holding.
        stop: End of the holding (exclusive).
        floor: First sample that may belong to the rest (the end of the holding before).
        tolerance: Metres.

    Returns:
        None if the object is never still between ``floor`` and ``start``, or never leaves that rest.
    """
    resting = np.flatnonzero(still[floor : start + 1]) + floor
    if len(resting) == 0:
        return None
    last = int(resting[-1])
    moving_before = np.flatnonzero(~still[floor:last])
    first = floor if len(moving_before) == 0 else floor + int(moving_before[-1]) + 1
    quiet = _quiet_part(track, first, last)
    rest = np.median(track.centre[quiet], axis=0)
    distance = np.linalg.norm(track.centre[last:stop] - rest, axis=1)
    away = np.flatnonzero(distance > 2 * tolerance)
    if len(away) == 0:
        return None
    # The still sample looks half a window ahead, so the way out may begin before it.
    begin, end = min(quiet.stop, last + int(away[0])) - 1, last + int(away[0]) + 1
    times, distance = track.times[begin:end], np.linalg.norm(track.centre[begin:end] - rest, axis=1)
    inner, crossing = _last_crossing(times, distance, tolerance)
    _, further = _last_crossing(times, distance, 2 * tolerance)
    return Departure(
        time=crossing - min(further - crossing, track.window / 2),
        gap=(float(times[inner]), float(times[inner + 1])),
        first_away=track.centre[begin + inner + 1],
        centre=rest,
        position=np.median(track.position[quiet], axis=0),
        rotation=_mean_rotation(track.rotation[quiet]),
    )


def _last_crossing(
    times: Float[np.ndarray, " n"], distance: Float[np.ndarray, " n"], level: float
) -> tuple[int, float]:
    """Index of the last sample within ``level`` (the first where none is), and the time at which it is passed."""
    near = np.flatnonzero(distance[:-1] <= level)
    inner = int(near[-1]) if len(near) else 0
    share = np.clip((level - distance[inner]) / max(distance[inner + 1] - distance[inner], 1e-12), 0.0, 1.0)
    return inner, float(times[inner] + share * (times[inner + 1] - times[inner]))


def _quiet_part(track: Track, first: int, last: int) -> slice:
    """Samples of a still run that lie before its end by half a window, at most the last second of them."""
    quiet_until = track.times[last] - track.window / 2
    stop = int(np.searchsorted(track.times, quiet_until, side="right"))
    stop = stop if stop > first else last + 1
    begin = int(np.searchsorted(track.times, track.times[stop - 1] - _LONGEST_REST))
    return slice(max(first, begin), stop)


def _mean_rotation(quaternions: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "4"]:
    return Rotation.from_quat(quaternions, scalar_first=True).mean().as_quat(scalar_first=True)
