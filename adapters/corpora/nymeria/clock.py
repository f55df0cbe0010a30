"""Find the offset from the glasses' clock, on which texts are timed, to the suit's: three ways, the first that works.

The offset is constant within a recording and differs between recordings (docs/specification/nymeria.md#narrations).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.alignment.clock import angular_speed, best_agreement
from prbench.errors import InputFileError
from prbench.files.storage import read_json
from prbench_adapters.corpora.nymeria.format import SUIT_RATE, Narration
from prbench_adapters.corpora.nymeria.suit import CleanSuit


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
    if suit is None or glasses is None:
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
