"""Streams of a recording that stop before the recording does, found through the dataset's reader."""

from __future__ import annotations

from prbench.errors import PrbenchError
from prbench.readers import KnowsEnds, RecordingFiles, reader_for
from prbench.readers.extents import shortfalls
from prbench.recording import Recording


def cut_short(found: RecordingFiles, recording: Recording | None = None) -> tuple[str, ...]:
    """Compare the ends of all streams of a recording with its span.

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
