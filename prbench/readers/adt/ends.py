"""From when to when the streams of an ADT recording reach."""

from __future__ import annotations

from dataclasses import replace

from prbench.readers.adt import format as adt
from prbench.readers.adt.layouts import GAZE, OBJECTS, SKELETON_PREFIX, TRAJECTORY
from prbench.readers.aria_mps.format import TIME_COLUMN
from prbench.readers.egoallo.ends import body_extent
from prbench.readers.extents import Extent
from prbench.readers.file_ends import csv_extent, json_extent
from prbench.readers.found import RecordingFiles
from prbench.recording import Recording


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The streams of one recording, on the device clock.

    Glasses and objects come from one tracking system, and tell how long there is ground truth. Gaze and the suit run
    longer; the suit may begin late.
    """
    streams = []
    for file in found.files:
        if file.role == TRAJECTORY:
            streams.append(csv_extent("glasses", file, TIME_COLUMN, 1e-6))
        elif file.role == OBJECTS:
            streams.append(csv_extent("objects", file, adt.OBJECT_TIME, 1e-9))
        elif file.role == GAZE:
            streams.append(replace(csv_extent("gaze", file, TIME_COLUMN, 1e-6), tells_span=False))
        elif file.role.startswith(SKELETON_PREFIX):
            streams.append(replace(json_extent("body", file), tells_span=False, may_start_late=True))
    body = body_extent(found)
    return tuple(streams) if body is None else (*streams, body)
