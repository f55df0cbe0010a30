"""Streams on one clock: nearest samples, resampling across no gap, clock mapping, and the grid of a sequence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.errors import StreamsDoNotOverlap

Times = Float[np.ndarray, " n"]
Query = Float[np.ndarray, " m"]  # the moments asked for

_ROUNDING = 1e-6  # seconds


def nearest_index(times: Times, query: Query) -> Int[np.ndarray, " m"]:
    """Index of the sample nearest to each query time; of two equally near ones the earlier.

    Args:
        times: Strictly increasing, at least one sample, seconds.
        query: Seconds, any order.
    """
    right = np.clip(np.searchsorted(times, query), 1, max(len(times) - 1, 1))
    if len(times) == 1:
        return np.zeros(len(query), dtype=np.int64)
    left = right - 1
    return np.where(query - times[left] <= times[right] - query, left, right)


def covered(
    times: Times, valid: Bool[np.ndarray, " n"], query: Query, *, max_gap: float, tolerance: float = _ROUNDING
) -> Bool[np.ndarray, " m"]:
    """Return True for each time that can be interpolated from *valid* neighbours at most ``max_gap`` apart.

    A query that coincides with a valid sample is covered whatever its neighbours are. Nothing is extrapolated.

    Args:
        times: Strictly increasing, seconds.
        valid: Samples that may be used.
        query: Seconds.
        max_gap: Largest distance between the two neighbours, seconds.
        tolerance: Slack for the equality of a query and a sample, seconds.
    """
    usable = times[valid]
    if len(usable) == 0:
        return np.zeros(len(query), dtype=bool)
    on_sample = np.abs(usable[nearest_index(usable, query)] - query) <= tolerance
    right = np.searchsorted(usable, query)
    between = (right > 0) & (right < len(usable))
    step = usable[np.clip(right, 0, len(usable) - 1)] - usable[np.clip(right - 1, 0, len(usable) - 1)]
    return on_sample | (between & (step <= max_gap + _ROUNDING))


def interpolate(times: Times, values: Float[np.ndarray, "n *shape"], query: Query) -> Float[np.ndarray, "m *shape"]:
    """Linear interpolation along the first axis; outside the range the end values are held.

    Combine with :func:`covered`, which says where the result means something.

    Args:
        times: Strictly increasing, seconds; one sample or more.
        values: One value a sample.
        query: Seconds.
    """
    if len(times) == 1:
        return np.broadcast_to(values, (len(query), *values.shape[1:])).copy()
    right = np.clip(np.searchsorted(times, query), 1, len(times) - 1)
    left = right - 1
    weight = np.clip((query - times[left]) / (times[right] - times[left]), 0.0, 1.0)
    weight = weight.reshape(-1, *(1,) * (values.ndim - 1))
    return values[left] * (1 - weight) + values[right] * weight


def slerp(times: Times, quaternions: Float[np.ndarray, "n 4"], query: Query) -> Float[np.ndarray, "m 4"]:
    """Spherical interpolation of rotations (w x y z) on the shorter arc; outside the range the end values are held."""
    if len(times) == 1:
        return np.broadcast_to(quaternions, (len(query), 4)).copy()
    if len(query) == 0:
        return np.empty((0, 4))
    from scipy.spatial.transform import Rotation, Slerp  # late: 0.3 s that a run and its workers do not need

    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    return Slerp(times, rotations)(np.clip(query, times[0], times[-1])).as_quat(scalar_first=True)


@dataclass(frozen=True)
class SequenceGrid:
    """The frame times of one sequence: uniform, ending exactly at the event (docs/specification/curation.md#clip)."""

    start_time: float
    fps: float
    n_frames: int

    @classmethod
    def ending_at(cls, event_time: float, *, prime_time: float, lead: float, fps: float) -> SequenceGrid:
        """Return the grid that covers ``[prime_time - lead, event_time]`` with its last frame on ``event_time``."""
        # Rounding must not cost a frame; the one added is the event's own.
        n_frames = int(np.floor((event_time - prime_time + lead) * fps + 1e-6)) + 1
        return cls(event_time - (n_frames - 1) / fps, fps, n_frames)

    @property
    def times(self) -> Float[np.ndarray, " n_frames"]:
        """Frame times, seconds."""
        return self.start_time + np.arange(self.n_frames) / self.fps


def stream_ranges(streams: Mapping[str, Float[np.ndarray, " _"] | None]) -> dict[str, tuple[float, float]]:
    """First and last time of each stream for :func:`require_overlap`; streams that are None or empty are left out."""
    known = {name: times for name, times in streams.items() if times is not None and len(times)}
    return {name: (float(times[0]), float(times[-1])) for name, times in known.items()}


def require_overlap(ranges: Mapping[str, tuple[float, float]], *, recording: str) -> tuple[float, float]:
    """Return the span that all streams share.

    Args:
        ranges: First and last time of each stream, seconds.
        recording: Name used in the error.

    Raises:
        StreamsDoNotOverlap: naming two streams without a common instant, both ranges and, where one exists, the unit
            that would make them overlap.
    """
    start = max(begin for begin, _ in ranges.values())
    end = min(end for _, end in ranges.values())
    if start <= end:
        return start, end
    late = max(ranges, key=lambda name: ranges[name][0])
    early = min(ranges, key=lambda name: ranges[name][1])
    told = [f"{name} {ranges[name][0]:,.3f} … {ranges[name][1]:,.3f} s" for name in (early, late)]
    hint = "No change of unit makes them overlap; check that the files belong to one recording and one clock."
    for factor, unit in ((1_000, "milliseconds"), (1_000_000, "microseconds"), (1_000_000_000, "nanoseconds")):
        if _overlap((ranges[early][0] * factor, ranges[early][1] * factor), ranges[late]):
            hint = f"{late} would overlap if its times were {unit}; check the unit of its time column."
            # The stream to look at is the one that the others do not agree with.
            agreeing = [sum(_overlap(ranges[name], span) for span in ranges.values()) for name in (late, early)]
            if agreeing[0] > agreeing[1]:
                hint = f"{early} would overlap if its times were {factor:,} times as large, the step from seconds to"
                hint += f" {unit}; check the unit of its time column."
            break
    raise StreamsDoNotOverlap(f"{recording}: streams do not overlap: {', '.join(told)}. {hint}")


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return one[0] <= other[1] and one[1] >= other[0]
