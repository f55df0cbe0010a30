"""Find the offset from the glasses' clock, on which texts are timed, to the suit's: three ways, the first that works.

The offset is constant within a recording and differs between recordings (docs/specification/nymeria.md#narrations).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from prbench.alignment.clock import find_clock
from prbench.errors import InputFileError
from prbench.files.storage import read_json
from prbench.recording import PoseStream
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
    clean: CleanSuit, glasses: PoseStream, thresholds: Mapping[str, float]
) -> tuple[ClockOffset | None, str]:
    """Return the offset at which the suit's head turns as the glasses do (docs/specification/alignment.md).

    Args:
        clean: The suit; its longest piece is used.
        glasses: Poses on the device clock.
        thresholds: The manifest's thresholds.

    Returns:
        The offset, or None and why not.
    """
    piece = max(clean.pieces, key=lambda piece: len(piece.joints))
    head = clean.head_rotation[piece.first : piece.stop]
    times = piece.start + np.arange(len(head)) / SUIT_RATE
    # Where the head is does not matter to how it turns.
    clock = find_clock(glasses, PoseStream(times, np.zeros((len(head), 3)), head, np.ones(len(head), dtype=bool)))
    if clock is None:
        return None, "the glasses' trajectory is too short or too broken to compare head movements"
    if doubt := clock.doubt(thresholds["correlation_peak"], thresholds["correlation_ratio"]):
        return None, f"head movements of suit and glasses agree by {doubt}"
    return ClockOffset("correlation", clock.offset, round(clock.peak, 6)), ""


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
