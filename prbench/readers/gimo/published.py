"""GIMO's segments as a study of motion prediction used them (docs/specification/motion-prediction.md#gimo)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.geometry.skeleton import transform_points
from prbench.protocol.manifests import Manifest
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.dataset_csv import read_segments
from prbench.readers.gimo.segments import GimoOptions
from prbench.readers.gimo.to_recording import filled
from prbench.recording.published_tracks import PublishedTrack
from prbench.recording.streams import BodyStream, Recording

GIMO23 = "gimo23"
"""The study's joint set: the 22 joints and the jaw."""
_SPLITS = {gimo.TRAIN: "train", gimo.TEST: "test", gimo.TRAIN_LATER: "unused"}
"""The official loader never uses the third value."""


def native_joints(options: GimoOptions) -> str:
    """The study's 23 joints where the options give a body model, which knows the jaw; else the 22 without it."""
    return GIMO23 if options.smplx_model is not None and options.body != "bvh" else "smpl22"


def published_track(
    readings: gimo.GimoReadings, recording: Recording, manifest: Manifest, *, with_jaw: bool
) -> PublishedTrack:
    """The one row of ``dataset.csv`` that a recording is, every frame of it.

    Args:
        readings: Of the segment.
        recording: Of the same.
        manifest: The longest gap of poses that is filled.
        with_jaw: Whether the joints are the study's 23 or the 22 of every dataset.

    Raises:
        InputFileError: if the jaw is asked for, and no body model tells where it is.
    """
    assert recording.body is not None
    body = recording.body
    posed = readings.body.frames if isinstance(readings.body, gimo.LocalJoints) else readings.body.poses.frames
    frames = readings.segment.frames
    has_pose = np.isin(frames, posed)
    return PublishedTrack(
        name=readings.segment.name,
        published_split=_SPLITS[readings.segment.training],
        times=body.times,
        joints=_and_jaw(readings, body, manifest) if with_jaw else body.joints,
        valid=body.valid,
        filled=body.valid & ~has_pose,
        body=body.joints,
        gaze=recording.gaze.direction,
        # A direction needs both ends of its own frame: a gaze point, and the head that it is seen from.
        gaze_measured=recording.gaze.valid & np.isin(frames, readings.gaze.frames) & has_pose,
    )


def _and_jaw(readings: gimo.GimoReadings, body: BodyStream, manifest: Manifest) -> Float[np.ndarray, "n 23 3"]:
    if not isinstance(readings.body, gimo.LocalJoints) or readings.body.jaw is None:
        raise InputFileError(
            readings.recording_id,
            "",
            expected="a jaw: fitted parameters or meshes, and an SMPL-X model with its 23rd joint",
            found="a body without one",
            remedy="Build the windows on the 22 joints (--joints smpl22).",
        )
    longest = round(manifest.thresholds["longest_filled_gap"])
    wanted, _ = filled(readings.body.frames, readings.body.jaw[:, None], readings.segment.frames, longest=longest)
    return np.concatenate([body.joints, transform_points(readings.transform.room_from_body(), wanted)], axis=1)


def published_lengths(root: Path) -> dict[str, tuple[int, ...]]:
    """Frames of every row of ``dataset.csv`` by published split; a row that stands there twice counts twice."""
    lengths: dict[str, list[int]] = {}
    for row in read_segments(root / gimo.TABLE_FILE):
        of_split = lengths.setdefault(_SPLITS[row.segment.training], [])
        of_split += [len(row.segment.frames)] * (1 + len(row.repeated))
    return {split: tuple(frames) for split, frames in sorted(lengths.items())}
