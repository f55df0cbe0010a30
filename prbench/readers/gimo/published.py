"""GIMO's segments as a study of motion prediction used them (docs/specification/motion-prediction.md#gimo)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.dataset_csv import read_segments
from prbench.recording.published_tracks import PublishedTrack
from prbench.recording.streams import Recording

_SPLITS = {gimo.TRAIN: "train", gimo.TEST: "test", gimo.TRAIN_LATER: "unused"}
"""The official loader never uses the third value."""


def published_track(readings: gimo.GimoReadings, recording: Recording) -> PublishedTrack:
    """The one row of ``dataset.csv`` that a recording is, every frame of it."""
    assert recording.body is not None
    body = recording.body
    posed = readings.body.frames if isinstance(readings.body, gimo.LocalJoints) else readings.body.poses.frames
    frames = readings.segment.frames
    has_pose = np.isin(frames, posed)
    return PublishedTrack(
        name=readings.segment.name,
        published_split=_SPLITS[readings.segment.training],
        times=body.times,
        joints=body.joints,
        valid=body.valid,
        filled=body.valid & ~has_pose,
        body=body.joints,
        gaze=recording.gaze.direction,
        # A direction needs both ends of its own frame: a gaze point, and the head that it is seen from.
        gaze_measured=recording.gaze.valid & np.isin(frames, readings.gaze.frames) & has_pose,
    )


def published_lengths(root: Path) -> dict[str, tuple[int, ...]]:
    """Frames of every row of ``dataset.csv`` by published split; a row that stands there twice counts twice."""
    lengths: dict[str, list[int]] = {}
    for row in read_segments(root / gimo.TABLE_FILE):
        of_split = lengths.setdefault(_SPLITS[row.segment.training], [])
        of_split += [len(row.segment.frames)] * (1 + len(row.repeated))
    return {split: tuple(frames) for split, frames in sorted(lengths.items())}
