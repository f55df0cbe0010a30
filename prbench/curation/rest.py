"""Find where an object rests before or after a movement, and when it leaves that rest.

Where the object was not tracked, the hands tell when in the gap the event happened.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from prbench.geometry.timelines import covered, interpolate
from prbench.recording import HandStream

_LONGEST_REST = 1.0  # seconds of rest that are averaged: enough to suppress sensor noise, short enough to be local


_STANDS_OUT = 2.6
"""Times the median distance of resting samples from their centre: 4 standard deviations of isotropic noise."""
_FINEST_LEVEL = 0.4
"""Share of the tolerance below which no movement is looked for, however quiet the rest: 1 mm of 2.5 mm."""
LONGEST_SURE_GAP = 0.1
"""Seconds; within a longer gap in the track, interpolation says nothing about when the movement began."""
_SAME_PLACE = 0.003  # metres; how exactly a hand has to come to where it held the object at rest
_RATE = 120.0
_LONGEST_HAND_GAP = 0.1


@dataclass(frozen=True)
class Departure:
    """An object leaves its rest (or, seen backwards in time, comes to rest)."""

    time: float
    """Beginning of the movement, seconds: see :func:`find_departure`."""
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

    @property
    def gap_length(self) -> float:
        """Seconds between the two samples."""
        return abs(self.gap[1] - self.gap[0])

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
    the rest. It has surely left once it is twice ``tolerance`` away; the boundary is where, on its way there, it passed
    the level at which a movement stands out from the noise of this rest, at most ``tolerance``. (An object that creeps
    away or settles slowly is 2.5 mm from its rest up to 0.1 s after its movement began or before it ends.)
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
    # Medians, because trackers jump now and then even while an object lies still.
    rest = np.median(track.centre[quiet], axis=0)
    distance = np.linalg.norm(track.centre[:stop] - rest, axis=1)
    away = np.flatnonzero(distance[last:] > 2 * tolerance) + last
    if len(away) == 0:
        return None
    # The last still sample looks half a window ahead, so the way out may begin before it: where the quiet part ends.
    way = slice(min(quiet.stop, int(away[0])) - 1, int(away[0]) + 1)
    noise = _STANDS_OUT * float(np.median(distance[quiet]))
    level = float(np.clip(noise, _FINEST_LEVEL * tolerance, tolerance))
    inner, time = _leaving(track.times[way], distance[way], level)
    inner += way.start
    return Departure(
        time=time,
        gap=(float(track.times[inner]), float(track.times[inner + 1])),
        first_away=track.centre[inner + 1],
        centre=rest,
        position=np.median(track.position[quiet], axis=0),
        rotation=_mean_rotation(track.rotation[quiet]),
    )


def _leaving(times: Float[np.ndarray, " n"], distance: Float[np.ndarray, " n"], level: float) -> tuple[int, float]:
    """Index of the last sample before ``level`` is passed, and the time at which it is passed.

    The passage that counts is the first one after the last sample within half of the level: who turns back half-way has
    not left, who dips just below the level has.
    """
    close = np.flatnonzero(distance[:-1] <= level / 2)
    home = int(close[-1]) if len(close) else 0
    inner = home + int(np.flatnonzero(distance[home + 1 :] > level)[0])
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


def placed_in_gap(departure: Departure, hands: tuple[HandStream, ...], distance: float) -> Departure:
    """Put an instant that falls into a tracking gap where the hand says it was.

    A held object moves with the hand that is nearest to it on the far side of the gap, and however it turns, its centre
    stays equally far from that hand. So the object can have been at its rest only while the hand was that far from the
    rest; within that time, it left when the hand's path, shifted to meet the object on the far side, leaves the point
    where it comes nearest to the rest. If the hand never comes that near, up to ``distance``, the middle of the gap is
    given and the departure marked as not placed.

    Args:
        departure: With its gap: from the sample at rest to the one away from it (backwards for a put).
        hands: Contact points that may have held the object.
        distance: Metres.
    """
    rest_time, away_time = departure.gap
    if departure.gap_length <= LONGEST_SURE_GAP:
        return departure
    times = np.linspace(
        away_time, rest_time, int(np.ceil(departure.gap_length * _RATE)) + 1
    )  # from the far side to the rest
    measured = [hand for hand in hands if covered(hand.times, hand.valid, times, max_gap=_LONGEST_HAND_GAP).all()]
    paths = [interpolate(hand.times[hand.valid], hand.points[hand.valid].mean(axis=1), times) for hand in measured]
    if paths:
        path = min(paths, key=lambda path: float(np.linalg.norm(path[0] - departure.first_away)))
        reach = float(np.linalg.norm(path[0] - departure.first_away))
        excess = np.linalg.norm(path - departure.centre, axis=1) - reach
        nearest = max(float(excess.min()), 0.0)
        if nearest < distance:
            apart = np.linalg.norm(departure.first_away + path - path[0] - departure.centre, axis=1)
            apart[excess > nearest + _SAME_PLACE] = np.inf
            return replace(departure, time=float(times[np.flatnonzero(apart <= apart.min() + _SAME_PLACE)[0]]))
    return replace(departure, time=(rest_time + away_time) / 2, placed=False)
