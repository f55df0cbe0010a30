"""From when to when the streams of a GIMO segment reach: one file a frame, so that a partial copy lacks frames."""

from __future__ import annotations

from prbench.readers.extents import ONE_SYSTEM, SEVERAL_SENSORS, Extent
from prbench.readers.found import RecordingFiles
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo import segments
from prbench.recording import Recording


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG001
    """The frames that the table promises, and those that have files; nothing is said of what has none at all."""
    segment = segments.row_of(found)[0].segment
    promised = segment.start_frame / gimo.FRAME_RATE, segment.end_frame / gimo.FRAME_RATE
    streams = [Extent("segment", gimo.TABLE_FILE, *promised)]
    roles = {segments.POSE: "body", segments.MESH: "body", segments.CENTRE: "gaze"}
    for role, stream in roles.items():
        files = segments.frames_of(found, role)
        if files:
            ends = min(files) / gimo.FRAME_RATE, max(files) / gimo.FRAME_RATE
            slack = SEVERAL_SENSORS if role == segments.CENTRE else ONE_SYSTEM  # eyes are lost now and then
            streams.append(Extent(stream, files[max(files)].name, *ends, tells_span=False, slack=slack))
    return tuple(streams)
