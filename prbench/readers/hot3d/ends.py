"""From when to when the streams of a HOT3D recording reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from prbench.readers.aria_mps.format import GAZE, TIME_COLUMN, TRAJECTORY
from prbench.readers.egoallo.ends import body_extent
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.file_ends import can_be_looked_at, csv_extent, json_extent
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.layout import HEADSET, MANO, MASK_PREFIX, OBJECTS, UMETRACK
from prbench.recording import Recording


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The streams of one recording, each clock from its own start.

    Ground truth and glasses have different clocks, which only reading all poses relates. The glasses record from the
    beginning to the end of the ground truth, or longer; so they are at least as long.
    """
    device = [
        _device_stream(file) for file in found.files if file.role in (TRAJECTORY, GAZE) and can_be_looked_at(file)
    ]
    body = body_extent(found)
    truth = [_truth_stream(file) for file in found.files if file.role in (HEADSET, OBJECTS, UMETRACK, MANO)]
    masks = [_truth_stream(file) for file in found.files if file.role.startswith(MASK_PREFIX)]
    return (*_from_start([*truth, *masks]), *_from_start(device if body is None else [*device, body]))


def _truth_stream(file: InputFile) -> Extent:
    """Hands have no row where none was seen, as at the start of many recordings."""
    if file.role in (UMETRACK, MANO):
        return replace(json_extent("hands", file), may_start_late=True)
    stream = {HEADSET: "glasses' ground truth", OBJECTS: "objects"}.get(file.role, "mask")
    return csv_extent(stream, file, hot3d.TIME, 1e-9)


def _device_stream(file: InputFile) -> Extent:
    stream = "glasses" if file.role == TRAJECTORY else "gaze"
    return replace(csv_extent(stream, file, TIME_COLUMN, 1e-6), tells_span=False, slack=SEVERAL_SENSORS)


def _from_start(streams: Sequence[Extent]) -> tuple[Extent, ...]:
    """The same with times since the first of all samples."""
    start = min((stream.first for stream in streams if stream.first is not None), default=0.0)
    return tuple(
        replace(
            stream,
            first=None if stream.first is None else stream.first - start,
            last=None if stream.last is None else stream.last - start,
        )
        for stream in streams
    )
