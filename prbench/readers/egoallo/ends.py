"""From when to when the outputs of EgoAllo reach."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from prbench.limits import LARGEST_UNPACKED_FOR_ITS_END
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.places import OUTPUT_ROLE
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.found import RecordingFiles


def body_extent(found: RecordingFiles) -> Extent | None:
    """All outputs of a recording together, on the device clock; None without outputs that can be read."""
    times = {file.path: _times(file.path) for file in found.files if file.role.startswith(OUTPUT_ROLE)}
    known = [each for each in times.values() if each.size]
    if not known:
        return None
    first = min(float(each.min()) for each in known)
    latest = max((path for path in times if times[path].size), key=lambda path: float(times[path].max()))
    return Extent(
        "body by EgoAllo",
        latest.name,
        first / 1e9,
        float(times[latest].max()) / 1e9,
        tells_span=False,
        slack=SEVERAL_SENSORS,
    )


def _times(path: Path) -> np.ndarray:
    """Times of one output, nanoseconds; none of a damaged one, which is told by whoever reads it."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{ego.TIMES}.npy") as member:
            if archive.getinfo(f"{ego.TIMES}.npy").file_size > LARGEST_UNPACKED_FOR_ITS_END:
                return np.zeros(0)
            return np.lib.format.read_array(member, allow_pickle=False)  # type: ignore[arg-type] - any file works
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return np.zeros(0)
