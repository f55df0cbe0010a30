"""From when to when each stream of a recording reaches, and which of them stop before the recording does.

A text file that was cut between two lines reads as whole, and what happened after the cut is missing without a word.
Only the other streams of the recording can tell: they go on. A reader with a method ``extents`` says which streams its
recordings have (:class:`prbench.readers.KnowsEnds`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from prbench.errors import PrbenchError
from prbench.readers import KnowsEnds, RecordingFiles, reader_for
from prbench.recording import Recording

ONE_SYSTEM = 0.5
"""Seconds by which two streams that one tracking system writes frame by frame may end apart: half of what a person
needs to reach for something, and more than the frames that are lost at the end of public samples (0.1 s)."""
SEVERAL_SENSORS = 2.0
"""Seconds by which sensors that start and stop by themselves, or the results of different programs, may begin or end
apart. In the public sample of the Machine Perception Services poses begin 1.4 s after gaze and end 1.1 s before it; the
first video frame of HD-EPIC may be more than 1 s late. No sequence begins in the two seconds before a look anyway."""
_REMEDY = "it may be cut off: compare its size with the original, or copy or download it again"


@dataclass(frozen=True)
class Extent:
    """From when to when one stream reaches."""

    stream: str
    """What it holds, as a person would say it."""
    file: str
    """Name of the file."""
    first: float | None
    """Time of its first sample, seconds on a clock that all streams of the recording share; None if unknown."""
    last: float | None
    """Time of its last sample; None if it holds none."""
    tells_span: bool = True
    """Whether the recording lasts at least as long. Not so where a dataset's sensors run on without ground truth."""
    may_start_late: bool = False
    """Whether a late start is normal."""
    slack: float = ONE_SYSTEM
    """Seconds by which it may begin after the recording or end before it."""


def cut_short(found: RecordingFiles, recording: Recording | None = None) -> tuple[str, ...]:
    """Hold the ends of all streams of a recording against its span.

    Args:
        found: The recording's files; only their ends are looked at.
        recording: What reading it gave, where somebody has: it tells what the ends of files in archives do not.

    Returns:
        One message a stream that ends early or begins late. None of a recording whose files cannot be made out
        (reading it says why), or whose reader does not know the ends.
    """
    reader = reader_for(found.dataset)
    if not isinstance(reader, KnowsEnds):
        return ()
    try:
        return shortfalls(reader.extents(found, recording))
    except (PrbenchError, OSError):
        return ()


def shortfalls(extents: Sequence[Extent]) -> tuple[str, ...]:
    """Say of each stream that stops before the recording does, or begins after it, by how much.

    The recording is as long as the longest of those streams that tell its span.

    Args:
        extents: Every stream of one recording of which the ends are known.

    Returns:
        One message a stream and end; none where all is well, or fewer than two streams can be compared.
    """
    starts = [extent.first for extent in extents if extent.tells_span and extent.first is not None]
    ends = [extent.last for extent in extents if extent.tells_span and extent.last is not None]
    if not starts or not ends:
        return ()
    start, end = min(starts), max(ends)
    return tuple(message for extent in extents for message in _told(extent, start, end))


def _told(extent: Extent, start: float, end: float) -> Iterator[str]:
    """What is to be said of one stream of a recording that lasts from ``start`` to ``end``, seconds."""
    named = f"{extent.stream} ({extent.file})"
    if extent.last is None:
        yield f"{named} holds no sample with a time: events may be missing; {_REMEDY}"
        return
    if extent.last < end - extent.slack:
        yield (
            f"{named} ends {end - extent.last:.1f} s before the recording does, {extent.last - start:.1f} s after"
            f" its start: later events may be missing; {_REMEDY}"
        )
    if extent.first is not None and extent.first > start + extent.slack and not extent.may_start_late:
        yield (
            f"{named} begins {extent.first - start:.1f} s after the recording does: earlier events may be missing;"
            f" {_REMEDY}"
        )
