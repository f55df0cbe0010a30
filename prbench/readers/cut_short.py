"""Which streams of a recording stop before it does (:mod:`prbench.readers.extents`), for any dataset."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from prbench.errors import PrbenchError
from prbench.readers import READER_MODULES, RecordingFiles
from prbench.readers.extents import Extent, shortfalls
from prbench.readers.synthetic_tree import SYNTHETIC_PREFIX
from prbench.recording import Recording

_Extents = Callable[[RecordingFiles, Recording | None], tuple[Extent, ...]]


def cut_short(found: RecordingFiles, recording: Recording | None = None) -> tuple[str, ...]:
    """Hold the ends of all streams of a recording against its span.

    Args:
        found: The recording's files; only their ends are looked at.
        recording: What reading it gave, where somebody has: it tells what the ends of files in archives do not.

    Returns:
        One message a stream that ends early or begins late. None of a recording whose files cannot be made out:
        reading it says why.
    """
    module = READER_MODULES[found.dataset.removeprefix(SYNTHETIC_PREFIX)]
    extents: _Extents = importlib.import_module(f"{module}.ends").extents
    try:
        return shortfalls(extents(found, recording))
    except (PrbenchError, OSError):
        return ()
