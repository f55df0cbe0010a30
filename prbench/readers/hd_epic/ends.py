"""From when to when the streams of an HD-EPIC video reach."""

from __future__ import annotations

from dataclasses import replace

from prbench.readers.aria_mps import format as mps
from prbench.readers.egoallo.ends import body_extent
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.file_ends import can_be_looked_at, csv_extent, json_extent
from prbench.readers.found import RecordingFiles
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.places import FRAMES, TIME
from prbench.recording import Recording

_MPS = {mps.TRAJECTORY: "glasses", mps.GAZE: "gaze", mps.WRISTS: "hands", mps.HAND_TRACKING: "hands"}


def extents(found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:
    """The streams of one video, on the device clock.

    Poses of the glasses lie in archives of hundreds of megabytes: their end is known once the video is read.
    """
    streams = []
    for file in found.files:
        if file.role == TIME:
            streams.append(csv_extent("video frames", file, hd_epic.DEVICE_TIME, 1e-9))
        elif file.role == FRAMES:
            streams.append(json_extent("frames of the intermediate data", file))
        elif file.role in _MPS and can_be_looked_at(file):
            streams.append(csv_extent(_MPS[file.role], file, mps.TIME_COLUMN, 1e-6))
        elif file.role == mps.TRAJECTORY and recording is not None:
            streams.append(Extent("glasses", file.member.rpartition("/")[2], *recording.span))
    body = body_extent(found)
    everything = streams if body is None else [*streams, body]
    return tuple(replace(stream, slack=SEVERAL_SENSORS) for stream in everything)
