"""The offset between two clocks and its drift, from how fast one head turns (docs/specification/alignment.md)."""

from __future__ import annotations

import msgspec
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from prbench.geometry.timelines import slerp
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
    first, second = (
        angular_speed(stream.times[stream.valid], stream.rotation[stream.valid], RATE) if stream.valid.any() else None
        for stream in (segment, device)
    )
    if first is None or second is None:
        return None
    if around is not None:
        return _refined(first, second, around, 0.0)
    lag, height, other = best_agreement(first, second, RATE)
    found = _refined(first, second, lag, other)
    if height < LEAST_PEAK:
        # A clock that drifts smears the peak of the whole; a part of the recording has a sharper one.
        third = len(second[1]) // 3
        middle = (second[0] + third / RATE, second[1][third:-third], second[2][third:-third])
        lag, _, other = best_agreement(first, middle, RATE)
        by_middle = _refined(first, second, lag, other)
        if found is None or (by_middle is not None and by_middle.peak > found.peak):
            return by_middle
    return found


def _refined(segment: Signal, device: Signal, offset: float, second_peak: float) -> Clock | None:
    """Search ±0.5 s around an offset, with the drift that makes the thirds of the overlap agree."""
    times = device[0] + np.arange(len(device[1])) / RATE
    segment_times = segment[0] + np.arange(len(segment[1])) / RATE
    at, rate, peak, bend, apart = float(times.mean()), 0.0, 0.0, 0.0, 0.0
    for _ in range(4):
        mapped = times + offset + rate * (times - at)
        seen = np.flatnonzero((mapped >= segment_times[0]) & (mapped <= segment_times[-1]))
        if len(seen) < 3 * RATE:
            return None
        speed = np.interp(mapped, segment_times, segment[1])
        valid = (np.interp(mapped, segment_times, segment[2].astype(float)) > 0.999) & np.isin(
            np.arange(len(times)), seen, assume_unique=True
        )
        middle = float(times[seen].mean())
        offset += rate * (middle - at)
        at = middle
        thirds = np.array_split(seen, 3)
        found = [_lag(device, speed, valid, slice(part[0], part[-1] + 1)) for part in (*thirds, seen)]
        lags = [lag for lag, _ in found]
        peak = found[3][1]
        # A third in which the head rests tells nothing of the drift.
        if min(height for _, height in found[:3]) > LEAST_PEAK / 2:
            apart = float(times[thirds[2]].mean() - times[thirds[0]].mean())
            rate += (lags[2] - lags[0]) / apart
            bend = lags[1] - (lags[0] + lags[2]) / 2
        offset += lags[3]
    return Clock(
        offset=offset, at=at, rate=rate, drift=rate * apart, bend=bend, peak=peak, second_peak=max(second_peak, 0.0)
    )


def _lag(device: Signal, speed: np.ndarray, valid: np.ndarray, part: slice) -> tuple[float, float]:
    """Return by how much the segment's speed lags behind within ±0.5 s, and the correlation there."""
    reach = round(_NEAR * RATE)
    a = device[1][part]
    scores = np.full(2 * reach + 1, -1.0)
    padded = np.pad(speed, reach)
    known = np.pad(valid, reach)
    for shift in range(2 * reach + 1):
        moved = slice(part.start + shift, part.stop + shift)
        both = device[2][part] & known[moved]
        if both.sum() >= _LEAST_OVERLAP * len(a):
            x, y = a[both], padded[moved][both]
            scores[shift] = np.corrcoef(x, y)[0, 1] if x.std() > 1e-9 and y.std() > 1e-9 else -1.0
    top = int(scores.argmax())
    return (top + _above_sample(scores, top) - reach) / RATE, float(scores[top])


def _above_sample(score: np.ndarray, top: int) -> float:
    """Return how far beyond the highest sample a parabola through it and its neighbours has its top."""
    if not 0 < top < len(score) - 1:
        return 0.0
    before, highest, after = score[top - 1 : top + 2]
    bend = before - 2.0 * highest + after
    return float(0.5 * (before - after) / bend) if bend < 0.0 and min(before, after) > -1.0 else 0.0


def angular_speed(times: Float[np.ndarray, " n"], rotation: Float[np.ndarray, "n 4"], rate: float) -> Signal | None:
    """Angular speed on a uniform grid; samples next to a gap in the poses are invalid. None below a second."""
    if (times[-1] - times[0]) * rate > _LONGEST_OF_CORRELATION:
        return None
    grid = np.arange(times[0], times[-1], 1.0 / rate)
    if len(grid) < rate:
        return None
    turned = Rotation.from_quat(slerp(times, rotation, grid), scalar_first=True)
    speed = (turned[:-1].inv() * turned[1:]).magnitude() * rate
    right = np.clip(np.searchsorted(times, grid, side="right"), 1, len(times) - 1)
    steady = times[right] - times[right - 1] <= LONGEST_GAP + 1e-6
    valid = steady[:-1] & steady[1:]
    # A speed between two samples belongs to the middle between them.
    return float(grid[0]) + 0.5 / rate, gaussian_filter1d(np.where(valid, speed, 0.0), _SMOOTHING * rate), valid


def best_agreement(first: Signal, second: Signal, rate: float) -> tuple[float, float, float]:
    """Normalised correlation over every lag at which at least half of the shorter signal overlaps.

    Mean and spread are those of the overlap itself, so that a lag at which the quiet ends meet is not preferred.

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
    enough = count >= _LEAST_OVERLAP * min(mask.sum() for mask in masks)
    n = np.maximum(count, 1.0)
    sum_a = correlate(a, masks[1])
    sum_b = correlate(masks[0], b)
    spread_a = np.maximum(correlate(a * a, masks[1]) - sum_a**2 / n, 1e-9)
    spread_b = np.maximum(correlate(masks[0], b * b) - sum_b**2 / n, 1e-9)
    score = np.where(enough, (correlate(a, b) - sum_a * sum_b / n) / np.sqrt(spread_a * spread_b), -1.0)
    best = int(score.argmax())
    away = np.abs(np.arange(len(score)) - best) > _SECOND_PEAK_AWAY * rate
    # The first score belongs to the lag -len(b) + 1.
    lag = best - (len(b) - 1) + _above_sample(score, best)
    return first[0] - second[0] + lag / rate, float(score[best]), float(score[away].max(initial=0.0))
