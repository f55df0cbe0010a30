"""Judges when noise-free gaze first meets a box: the truth that curation is compared with.

Sources: *Prime and Reach*, sections 3.1 and B.1, equations 2 and 4 to 7;
docs/specification/curation.md#prime-time (degenerate rays and boxes) and
docs/specification/synthetic-recordings.md#truth-record (what is ``thin``).

The truth must not share a mistake with the curation that it judges. So the equations stand here a second time, as a
slow loop over one ray, one box and one axis at a time, and nothing of ``prbench.geometry.rays`` or
``prbench.curation`` is
imported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, inf
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.protocol.manifests import load_protocol

_LASTING = 0.050
"""Seconds that a look lasts at least; a saccade that sweeps across the box is shorter."""
_SETTLING = 0.100
"""Seconds from the start of a look that decide between hit and near miss."""
_THIN_RAY = 0.005
"""Metres from the near-miss border within which noise decides."""

_Vector = Sequence[float]


@dataclass(frozen=True)
class Sight:
    """When and how a box is first seen before an event."""

    lasting: float | None
    """First instant of a look of at least 50 ms, seconds."""
    first: float | None
    """First instant of any look, seconds."""
    kind: Literal["hit", "near_miss"] | None
    """``hit`` if the look's first tenth of a second is mostly on the box: an arriving saccade crosses its border."""
    marginal: bool
    """True where a gaze sample more or less, or 5 mm, would change whether or when the event is primed."""


@dataclass(frozen=True)
class _Samples:
    """Gaze samples of the priming window, and the looks that they form."""

    times: Float[np.ndarray, " n"]
    hits: list[bool]
    """True where the ray meets the box."""
    distances: list[float]
    """Metres between ray and box, infinite behind the eye."""
    looks: list[tuple[int, int]]
    """First sample of each unbroken look at the box, and the sample after its last."""
    step: float
    """Seconds between two samples."""

    def is_borderline(self, row: int) -> bool:
        """Return True where 5 mm decide whether the ray nearly misses the box."""
        border = load_protocol().curation.near_miss_distance
        return not self.hits[row] and abs(self.distances[row] - border) < _THIN_RAY


def slab_interval(origin: _Vector, direction: _Vector, low: _Vector, high: _Vector) -> tuple[float, float]:
    """Return where one ray enters and leaves one axis-aligned box (equation 4).

    Args:
        origin: Ray origin (3), metres.
        direction: Unit direction (3).
        low: Lower corner of the box (3), metres, same frame.
        high: Upper corner.

    Returns:
        Distances t_near and t_far along the ray, metres; infinity and minus infinity if the ray runs beside the box.
    """
    near = -inf
    far = inf
    for start, slope, lower, upper in zip(origin, direction, low, high, strict=True):
        if slope == 0.0:
            # The ray keeps its distance from both planes: it is between them all along, or never.
            if not lower <= start <= upper:
                return inf, -inf
            continue
        one = (lower - start) / slope
        other = (upper - start) / slope
        near = max(near, min(one, other))
        far = min(far, max(one, other))
    return near, far


def meets_box(origin: _Vector, direction: _Vector, low: _Vector, high: _Vector) -> bool:
    """Return True where the ray meets the box (equation 4); arguments as for :func:`slab_interval`."""
    near, far = slab_interval(origin, direction, low, high)
    return near < far and far >= 0.0


def passing_distance(origin: _Vector, direction: _Vector, low: _Vector, high: _Vector) -> float:
    """Return how far a ray passes beside a box, metres (equations 5 to 7); arguments as for :func:`slab_interval`.

    Returns:
        The distance between the ray's point closest to the box centre and the point where the ray from there to the
        centre meets the box: 0 if the closest point lies inside, infinity if it lies behind the origin.
    """
    centre = [(lower + upper) / 2.0 for lower, upper in zip(low, high, strict=True)]
    along = 0.0
    for start, slope, middle in zip(origin, direction, centre, strict=True):
        along += (middle - start) * slope
    if along < 0.0:
        return inf
    closest = [start + along * slope for start, slope in zip(origin, direction, strict=True)]
    if all(lower <= value <= upper for lower, value, upper in zip(low, closest, high, strict=True)):
        return 0.0
    length = hypot(*(middle - value for middle, value in zip(centre, closest, strict=True)))
    to_centre = [(middle - value) / length for middle, value in zip(centre, closest, strict=True)]
    # Equation 6 casts the second ray from the centre; t_near is negative, on the side of the closest point.
    near, _ = slab_interval(centre, to_centre, low, high)
    return length + near


def first_sight(
    times: Float[np.ndarray, " n"],
    eye: Float[np.ndarray, "n 3"],
    gaze: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    event_time: float,
    *,
    gaze_period: float = 1.0 / 30.0,
) -> Sight:
    """Find the first look at a box in the priming window before an event (equation 2).

    Args:
        times: Seconds, uniform.
        eye: True eye positions, metres.
        gaze: True unit gaze directions.
        low: Lower corner of the world-aligned box, metres; equal to ``high`` for a point.
        high: Upper corner.
        event_time: Seconds.
        gaze_period: Seconds between two gaze samples of the imitated dataset.
    """
    samples = _samples(times, eye, gaze, low.tolist(), high.tolist(), event_time)
    lasting = next((look for look in samples.looks if _lasts(look, samples.step, _LASTING)), None)
    first = float(samples.times[samples.looks[0][0]]) if samples.looks else None
    if lasting is None:
        marginal = bool(samples.looks) or any(samples.is_borderline(row) for row in range(len(samples.times)))
        return Sight(lasting=None, first=first, kind=None, marginal=marginal)
    begin = lasting[0]
    settling = samples.hits[begin : begin + int(np.ceil(_SETTLING / samples.step)) + 1]
    return Sight(
        lasting=float(samples.times[begin]),
        first=first,
        kind="hit" if 2 * sum(settling) >= len(settling) else "near_miss",
        marginal=_is_marginal(samples, lasting, event_time, gaze_period),
    )


def _samples(
    times: np.ndarray, eye: np.ndarray, gaze: np.ndarray, low: _Vector, high: _Vector, event_time: float
) -> _Samples:
    """Judge every gaze sample of the window, both ends included."""
    curation = load_protocol().curation
    inside = (times >= event_time - curation.priming_window) & (times <= event_time)
    hits: list[bool] = []
    distances: list[float] = []
    looks: list[tuple[int, int]] = []
    begin: int | None = None
    for row, (origin, direction) in enumerate(zip(eye[inside].tolist(), gaze[inside].tolist(), strict=True)):
        hits.append(meets_box(origin, direction, low, high))
        distances.append(passing_distance(origin, direction, low, high))
        is_seen = hits[row] or distances[row] <= curation.near_miss_distance
        if is_seen and begin is None:
            begin = row
        if not is_seen and begin is not None:
            looks.append((begin, row))
            begin = None
    if begin is not None:
        looks.append((begin, len(hits)))
    return _Samples(times[inside], hits, distances, looks, step=float(times[1] - times[0]))


def _lasts(look: tuple[int, int], step: float, seconds: float) -> bool:
    """Return True where a look lasts at least so many seconds."""
    begin, stop = look
    return (stop - begin) * step >= seconds


def _is_marginal(samples: _Samples, lasting: tuple[int, int], event_time: float, gaze_period: float) -> bool:
    """Return True where a sample more or less, or 5 mm, would change when the event is primed."""
    begin, _ = lasting
    start = float(samples.times[begin])
    window_start = event_time - load_protocol().curation.priming_window
    if start < window_start + gaze_period or start + 2 * gaze_period > event_time:
        return True
    if not _lasts(lasting, samples.step, gaze_period):
        return True
    # A look shorter than two gaze periods may be sampled or not.
    has_brief_look = any(not _lasts(look, samples.step, 2 * gaze_period) for look in samples.looks)
    if has_brief_look and samples.looks[0][0] < begin:
        return True
    # The approach itself crosses the border in the last tenth of a second; only an earlier graze is another look.
    if any(samples.is_borderline(row) for row in range(begin - int(0.1 / samples.step))):
        return True
    stop = min(begin + max(2, int(2 * gaze_period / samples.step)), len(samples.times))
    return all(samples.is_borderline(row) for row in range(begin, stop))
