"""GIMO's segments as motion prediction uses them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.published import published_track
from tests.readers import gimo_sample


def test_a_row_is_one_piece_with_all_its_frames():
    readings = gimo_sample.readings()
    track = published_track(readings, gimo_sample.recording(readings))
    assert (track.published_split, len(track.joints)) == ("train", gimo_sample.N_FRAMES)
    assert track.gaze_measured.all()
    assert not track.filled.any()


def test_poses_and_gaze_that_were_interpolated_are_no_measurements():
    sound = gimo_sample.readings()
    assert isinstance(sound.body, gimo.LocalSkeleton)
    keep = np.delete(np.arange(gimo_sample.N_FRAMES), 20)
    poses = sound.body.poses
    fewer = gimo.SmplxPoses(poses.frames[keep], poses.orient[keep], poses.trans[keep], poses.latent[keep])
    seen = np.delete(np.arange(gimo_sample.N_FRAMES), 30)
    readings = replace(
        sound,
        body=replace(sound.body, poses=fewer),
        gaze=gimo.GazePoints(sound.gaze.frames[seen], sound.gaze.points[seen]),
        segment=replace(sound.segment, training=gimo.TEST),
    )
    track = published_track(readings, gimo_sample.recording(readings))
    assert track.published_split == "test"
    assert np.flatnonzero(track.filled).tolist() == [20]
    assert np.flatnonzero(~track.gaze_measured).tolist() == [20, 30]
