"""MoGaze's segments as a study of motion prediction used them (docs/specification/motion-prediction.md#mogaze)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from prbench.geometry.skeleton import transform_points
from prbench.readers.mogaze import body as mogaze_body
from prbench.readers.mogaze import format as mogaze
from prbench.recording.body_quality import hold_neighbours
from prbench.recording.published_tracks import PublishedTrack
from prbench.recording.streams import Recording

_STEP = 4
"""120 frames a second become 30."""
FEWEST_GAZE = 0.8
"""Share of a segment's frames with confident gaze; the segment is left out below."""


def published_tracks(
    readings: mogaze.MogazeReadings, recording: Recording, *, least_confidence: float
) -> tuple[PublishedTrack, ...]:
    """Every row of ``segments`` as a pick or a place, cut to its first and last confident gaze.

    A row without an object in motion is the pick that comes next (``pick_001``), one with an object is the ``place``.
    Rows that end before they begin, and a row like the one before it, are left out.

    Args:
        readings: Content of the files.
        recording: What was made of them.
        least_confidence: Of a gaze sample.
    """
    links, _ = mogaze_body.forward_kinematics(readings.state, mogaze_body.link_offsets(readings.fixed))
    assert recording.body is not None
    body = recording.body
    joints = hold_neighbours(transform_points(recording.world_from_source, links), body.valid)
    confident = recording.gaze.valid & (readings.gaze_confidence >= least_confidence)
    tracks = []
    for name, segment in _named(readings.segments):
        frames = np.arange(max(segment.start, 0), min(segment.end + 1, len(joints)), _STEP)
        measured = confident[frames]
        if not len(frames) or measured.mean() < FEWEST_GAZE:
            continue
        first, last = np.flatnonzero(measured)[[0, -1]]
        kept = frames[first : last + 1]
        tracks.append(
            PublishedTrack(
                name=name,
                published_split="",
                times=kept / mogaze.RATE,
                joints=joints[kept],
                valid=body.valid[kept],
                filled=np.zeros(len(kept), dtype=bool),
                body=body.joints[kept],
                gaze=recording.gaze.direction[kept],
                gaze_measured=confident[kept],
            )
        )
    return tuple(tracks)


def _named(segments: tuple[mogaze.Segment, ...]) -> Iterator[tuple[str, mogaze.Segment]]:
    """Segments in the order of time with the study's names, without repetitions."""
    number = 0
    previous = ""
    for segment in sorted(segments, key=lambda each: each.start):
        repeated = segment.label == previous == mogaze.NULL_LABEL
        previous = segment.label
        if segment.end <= segment.start or repeated:
            continue
        number += 1
        kind = "pick" if segment.label == mogaze.NULL_LABEL else "place"
        yield f"{kind}_{number:03d}", segment
