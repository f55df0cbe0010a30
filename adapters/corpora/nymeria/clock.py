"""Find the offset from the glasses' clock, on which texts are timed, to the suit's: three ways, the first that works.

The offset is constant within a recording and differs between recordings (docs/specification/nymeria.md#narrations).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.files.storage import read_json
from prbench.geometry.timelines import slerp
from prbench.readers.aria_mps.format import LONGEST_POSE_STEP
from prbench_adapters.corpora.nymeria.format import SUIT_RATE, Narration
from prbench_adapters.corpora.nymeria.suit import CleanSuit

_SMOOTHING = 0.05  # s: what the glasses shake on the head and the suit does not see
_SECOND_PEAK_AWAY = 1.0  # s
_LEAST_OVERLAP = 0.5  # of the shorter signal
_LONGEST_OF_CORRELATION = 1e7  # samples; a broken clock must not ask for all memory


@dataclass(frozen=True)
class ClockOffset:
    """The offset that turns text times into suit times: ``TIME_CODE = device time + seconds``.

    Attributes:
        method: ``known``: synthetic people, whose clocks nobody has to find.
        quality: Height of the correlation's peak.
    """

    method: Literal["file", "correlation", "start_alignment", "known"]
    seconds: float
    quality: float | None = None

    @property
    def approximate(self) -> bool:
        """Return True if only the starts were aligned."""
        return self.method == "start_alignment"


# Angular speed on a uniform grid: seconds of the first sample, radians a second, and which samples are valid.
Signal = tuple[float, Float[np.ndarray, "_"], Bool[np.ndarray, "_"]]


def offset_from_file(path: Path, sequence: str) -> ClockOffset | None:
    """Return the user's own offset of a sequence; None where the file does not name it.

    Raises:
        InputFileError: if the file is no table of numbers.
    """
    entries = read_json(path)
    if not isinstance(entries, dict):
        raise InputFileError(path, "", expected="{sequence: seconds}", found=type(entries).__name__)
    if sequence not in entries:
        return None
    value = entries[sequence]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputFileError(path, sequence, expected="TIME_CODE minus device time in seconds", found=repr(value))
    return ClockOffset("file", float(value))


def offset_by_correlation(
    clean: CleanSuit, time_us: np.ndarray, rotation: Float[np.ndarray, "n 4"], thresholds: Mapping[str, float]
) -> tuple[ClockOffset | None, str]:
    """Return the offset at which the suit's head turns as the glasses do.

    Args:
        clean: The suit; its longest piece is used.
        time_us: Times of the glasses' poses, microseconds, device clock.
        rotation: Rotations of the glasses at these times, w x y z.
        thresholds: The manifest's thresholds.

    Returns:
        The offset, or None and why not.
    """
    rate = thresholds["correlation_rate"]
    piece = max(clean.pieces, key=lambda piece: len(piece.joints))
    head = clean.head_rotation[piece.first : piece.stop]
    suit = angular_speed(piece.start + np.arange(len(head)) / SUIT_RATE, head, rate)
    glasses = angular_speed(time_us.astype(np.float64) / 1e6, rotation, rate)
    if suit is None or glasses is None or len(suit[1]) + len(glasses[1]) > _LONGEST_OF_CORRELATION:
        return None, "the glasses' trajectory is too short or too broken to compare head movements"
    lag, height, second = best_agreement(suit, glasses, rate)
    needed = thresholds["correlation_peak"]
    ratio = thresholds["correlation_ratio"]
    if height < needed or height < ratio * second:
        return None, (
            f"head movements of suit and glasses agree by {height:.2f} only"
            f" (second peak {second:.2f}; needed {needed:g} and {ratio:g} times the second)"
        )
    return ClockOffset("correlation", lag, round(height, 6)), ""


def angular_speed(times: Float[np.ndarray, " n"], rotation: Float[np.ndarray, "n 4"], rate: float) -> Signal | None:
    """Angular speed on a uniform grid; samples next to a gap in the poses are invalid. None below a second."""
    grid = np.arange(times[0], times[-1], 1.0 / rate)
    if len(grid) < rate or len(grid) > _LONGEST_OF_CORRELATION:
        return None
    turned = Rotation.from_quat(slerp(times, rotation, grid), scalar_first=True)
    speed = (turned[:-1].inv() * turned[1:]).magnitude() * rate
    right = np.clip(np.searchsorted(times, grid, side="right"), 1, len(times) - 1)
    steady = times[right] - times[right - 1] <= LONGEST_POSE_STEP
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
    # The first score belongs to the lag -len(b) + 1; a parabola through three samples tells where the top is.
    lag = best - (len(b) - 1)
    if 0 < best < len(score) - 1:
        before, top, after = score[best - 1 : best + 2]
        bend = before - 2.0 * top + after
        if bend < 0.0 and min(before, after) > -1.0:
            lag += float(0.5 * (before - after) / bend)
    return first[0] - second[0] + lag / rate, float(score[best]), float(score[away].max(initial=0.0))


def offset_by_starts(
    narrations: Sequence[Narration], clean: CleanSuit, thresholds: Mapping[str, float]
) -> tuple[ClockOffset | None, str]:
    """Return the offset at which the first text begins as long after the suit as it does in sequences of known offset.

    Returns:
        The offset, or None and why not.
    """
    start, end = clean.span
    slack = thresholds["start_slack"]
    offset = start + thresholds["start_lead"] - min(row.start for row in narrations)
    last = max(row.end for row in narrations) + offset
    if (min(row.start for row in narrations) + offset) < start - slack or last > end + slack:
        return None, f"with aligned starts the texts end {last - end:.1f} s after the suit"
    return ClockOffset("start_alignment", offset), ""
