"""The offset between two clocks and its drift, from how fast one head turns (docs/specification/alignment.md)."""

from __future__ import annotations

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation

from prbench.geometry.timelines import covered, slerp
from prbench.recording import PoseStream

RATE = 100.0  # Hz
LEAST_PEAK = 0.8  # correlation at which two trackers are believed to have been on one head
LEAST_RATIO = 1.2  # and least ratio to the second peak: a rhythm has no single offset
LONGEST_GAP = 0.1  # s; nothing is interpolated across a longer one
_SMOOTHING = 0.05  # s: what the glasses shake on the head and the suit does not see
_SECOND_PEAK_AWAY = 1.0  # s
_LEAST_OVERLAP = 0.5  # of the shorter signal
_LONGEST_OF_CORRELATION = 5e6  # samples; a broken clock must not ask for all memory
_NEAR = 0.5  # s on either side of a known offset that are searched
_ALL_VALID = 0.999  # interpolated mask of a sample between two valid ones

# Angular speed on a uniform grid: seconds of the first sample, radians a second, and which samples are valid.
Signal = tuple[float, Float[np.ndarray, "_"], Bool[np.ndarray, "_"]]


class Clock(msgspec.Struct, frozen=True, kw_only=True):
    """How to get from the device's clock to the segment's.

    Attributes:
        offset: Segment's clock minus the device's at the instant ``at``, seconds.
        at: Middle of the overlap, seconds, device clock.
        rate: Seconds by which the offset grows each second.
        drift: Offset of the last third of the overlap minus that of the first, seconds.
        bend: Offset of the middle third minus the mean of the other two, seconds; 0 of a clock that runs evenly.
        peak: Correlation of the angular speeds at this offset and drift.
        second_peak: Highest other peak at least one second away; 0 where only ±0.5 s were searched.
    """

    offset: float
    at: float
    rate: float
    drift: float
    bend: float
    peak: float
    second_peak: float

    def doubt(self, least_peak: float = LEAST_PEAK, least_ratio: float = LEAST_RATIO) -> str:
        """Return how high the peak is where that does not settle the clock, else an empty text."""
        if self.peak >= max(least_peak, least_ratio * self.second_peak):
            return ""
        needed = f"second peak {self.second_peak:.2f}; needed {least_peak:g} and {least_ratio:g} times the second"
        return f"{self.peak:.2f} only ({needed})"

    def to_segment(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return device times on the segment's clock, seconds."""
        return times + self.offset + self.rate * (times - self.at)

    def to_device(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return times of the segment on the device's clock, seconds."""
        return self.at + (times - self.offset - self.at) / (1.0 + self.rate)


def find_clock(device: PoseStream, segment: PoseStream, *, around: float | None = None) -> Clock | None:
    """Find offset and drift at which device and segment turn alike.

    Args:
        device: Poses on the device's clock.
        segment: Poses of the segment that carries it, on another clock.
        around: Offset that is known to within half a second; None searches all offsets.

    Returns:
        The best offset, however bad it is; None where there are too few poses to compare.
    """
    first = angular_speed(segment)
    second = angular_speed(device)
    if first is None or second is None:
        return None
    if around is not None:
        return _refined(first, second, around, 0.0)
    # A clock that drifts smears the peak of the whole; a part of the recording has a sharper one.
    third = len(second[1]) // 3
    middle = (second[0] + third / RATE, second[1][third : 2 * third], second[2][third : 2 * third])
    best = None
    for part in (second, middle):
        lag, _, other = best_agreement(first, part)
        found = _refined(first, second, lag, other)
        best = found if best is None or (found is not None and found.peak > best.peak) else best
        if best is not None and not best.doubt():
            break
    return best


def _refined(segment: Signal, device: Signal, offset: float, second_peak: float) -> Clock | None:
    """Search ±0.5 s around an offset, with the drift that makes the thirds of the overlap agree."""
    times = device[0] + np.arange(len(device[1])) / RATE
    segment_times = segment[0] + np.arange(len(segment[1])) / RATE
    at = float(times.mean())
    rate, drift, bend, peak = 0.0, 0.0, 0.0, 0.0
    for _ in range(4):
        mapped = times + offset + rate * (times - at)
        inside = np.flatnonzero((mapped >= segment_times[0]) & (mapped <= segment_times[-1]))
        if len(inside) < 3 * RATE:
            return None
        moved = float(times[inside].mean()) - at
        offset, at = offset + rate * moved, at + moved
        # The segment's speed at the device's samples, as the clocks are believed to run.
        speed = np.interp(mapped[inside], segment_times, segment[1])
        valid = np.interp(mapped[inside], segment_times, segment[2].astype(float)) > _ALL_VALID
        found = []
        for part in (*np.array_split(np.arange(len(inside)), 3), np.arange(len(inside))):
            there = device[1][inside[part]], device[2][inside[part]]
            found.append(best_agreement((0.0, speed[part], valid[part]), (0.0, *there), within=_NEAR))
        # A third in which the head rests tells nothing of the drift.
        lags, heights, _ = zip(*found, strict=True)
        if min(heights[:3]) > LEAST_PEAK / 2:
            apart = len(inside) / RATE * 2 / 3
            rate += (lags[2] - lags[0]) / apart
            drift, bend = rate * apart, lags[1] - (lags[0] + lags[2]) / 2
        offset, peak = offset + lags[3], heights[3]
    return Clock(offset=offset, at=at, rate=rate, drift=drift, bend=bend, peak=peak, second_peak=second_peak)


def angular_speed(stream: PoseStream) -> Signal | None:
    """Angular speed of a stream's valid poses at 100 Hz; samples beside a gap are invalid. None below a second."""
    times = stream.times[stream.valid]
    if len(times) == 0 or not 1.0 <= times[-1] - times[0] <= _LONGEST_OF_CORRELATION / RATE:
        return None
    grid = np.arange(times[0], times[-1], 1.0 / RATE)
    turned = Rotation.from_quat(slerp(times, stream.rotation[stream.valid], grid), scalar_first=True)
    velocity = (turned[:-1].inv() * turned[1:]).as_rotvec() * RATE
    steady = covered(times, np.ones(len(times), dtype=bool), grid, max_gap=LONGEST_GAP)
    valid = steady[:-1] & steady[1:]
    # Smoothed as vectors, because the length of noise never averages to zero; what a gap was mixed into is invalid.
    smooth = gaussian_filter1d(np.where(valid[:, None], velocity, 0.0), _SMOOTHING * RATE, axis=0, truncate=4.0)
    valid = minimum_filter1d(valid, size=2 * round(4.0 * _SMOOTHING * RATE) + 1)
    # A speed between two samples belongs to the middle between them.
    return float(grid[0]) + 0.5 / RATE, np.linalg.norm(smooth, axis=1), valid


def best_agreement(first: Signal, second: Signal, *, within: float = np.inf) -> tuple[float, float, float]:
    """Normalised correlation over every lag at which at least half of the shorter signal overlaps.

    Mean and spread are those of the overlap itself, so that a lag at which the quiet ends meet is not preferred.

    Args:
        first: Angular speed, as :func:`angular_speed` returns it.
        second: Another one.
        within: Largest lag of the samples, seconds.

    Returns:
        Seconds by which the first signal's clock is ahead of the second's, the height of that peak, and the height of
        the highest other peak at least one second away.
    """
    # As long as both together: a shorter transform would wrap one end onto the other.
    size = 1 << (len(first[1]) + len(second[1]) - 1).bit_length()

    def correlate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Sum over i of a[i + lag] b[i] for the lags -len(b) + 1 … len(a) - 1."""
        product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
        return np.concatenate([product[size - len(b) + 1 :], product[: len(a)]])

    masks = first[2].astype(float), second[2].astype(float)
    a, b = (signal[1] * mask for signal, mask in zip((first, second), masks, strict=True))
    count = np.rint(correlate(*masks))
    lags = np.arange(len(count)) - (len(b) - 1)
    enough = (count >= _LEAST_OVERLAP * min(mask.sum() for mask in masks)) & (np.abs(lags) <= within * RATE)
    n = np.maximum(count, 1.0)
    sum_a = correlate(a, masks[1])
    sum_b = correlate(masks[0], b)
    spread_a = np.maximum(correlate(a * a, masks[1]) - sum_a**2 / n, 1e-9)
    spread_b = np.maximum(correlate(masks[0], b * b) - sum_b**2 / n, 1e-9)
    score = np.where(enough, (correlate(a, b) - sum_a * sum_b / n) / np.sqrt(spread_a * spread_b), -1.0)
    best = int(score.argmax())
    away = np.abs(lags - lags[best]) > _SECOND_PEAK_AWAY * RATE
    # A parabola through three samples tells where the top is.
    lag = float(lags[best])
    if 0 < best < len(score) - 1:
        before, top, after = score[best - 1 : best + 2]
        bend = before - 2.0 * top + after
        if bend < 0.0 and min(before, after) > -1.0:
            lag += float(0.5 * (before - after) / bend)
    return first[0] - second[0] + lag / RATE, float(score[best]), float(score[away].max(initial=0.0))
