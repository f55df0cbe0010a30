"""From when to when the streams of a MoGaze recording reach."""

from __future__ import annotations

import h5py

from prbench.errors import InputFileError
from prbench.readers.extents import Extent
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.arrays import opened
from prbench.recording import Recording


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The streams of one recording: frames at one rate, all from frame 0; labels begin and end with nothing in hand."""
    return tuple(stream for file in found.files if (stream := _extent(file)) is not None)


def _extent(file: InputFile) -> Extent | None:
    human, objects, gaze, segments = mogaze.PARTS
    streams = {human: "body", objects: "objects", gaze: "gaze", segments: "labels"}
    if file.role not in streams:
        return None
    try:
        with opened(file.path) as content:
            last = _last_label(content) if file.role == segments else _last_frame(content)
    except (InputFileError, KeyError):
        return None  # reading says what is wrong with it
    seconds = None if last is None else last / mogaze.RATE
    return Extent(streams[file.role], file.path.name, 0.0, seconds, tells_span=file.role != segments)


def _last_frame(content: h5py.File) -> int | None:
    """Of the shortest array of a file; None where it holds no frame."""
    bodies = content.get(mogaze.OBJECT_GROUP)
    arrays = list(bodies.values()) if isinstance(bodies, h5py.Group) else []
    arrays += [content[name] for name in (mogaze.HUMAN_DATASET, mogaze.GAZE_DATASET) if name in content]
    frames = min((array.shape[0] for array in arrays if isinstance(array, h5py.Dataset) and array.ndim), default=0)
    return frames - 1 if frames else None


def _last_label(content: h5py.File) -> int | None:
    """Last frame of the last label; None where nothing is labelled."""
    rows = content[mogaze.SEGMENT_DATASET]
    if not isinstance(rows, h5py.Dataset) or rows.ndim != 1 or len(rows) == 0:
        return None
    return int(rows[len(rows) - 1][1])
