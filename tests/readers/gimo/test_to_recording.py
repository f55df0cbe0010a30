"""GIMO's segments as motion prediction uses them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.protocol.manifests import load_manifest
from prbench.readers.gimo import GimoOptions, GimoReader
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.to_recording import published_track
from prbench_benchmarks.motion_prediction.joint_sets import JOINT_SETS
from tests.readers import gimo_sample


def test_a_row_is_one_piece_with_all_its_frames():
    readings = gimo_sample.readings()
    track = published_track(readings, gimo_sample.recording(readings), load_manifest("gimo"), with_jaw=False)
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
    track = published_track(readings, gimo_sample.recording(readings), load_manifest("gimo"), with_jaw=False)
    assert track.published_split == "test"
    assert np.flatnonzero(track.filled).tolist() == [20]
    assert np.flatnonzero(~track.gaze_measured).tolist() == [20, 30]


def test_the_study_has_a_jaw_where_a_body_model_tells_it():
    sound = gimo_sample.readings()
    keep = np.delete(np.arange(gimo_sample.N_FRAMES), 20)
    joints = np.zeros((len(keep), 22, 3))
    jaw = np.zeros((len(keep), 3))
    jaw[:, 0] = keep  # moves a metre a frame along x
    body = gimo.LocalJoints(sound.segment.frames[keep], joints, jaw)
    recording = gimo_sample.recording(sound)
    track = published_track(replace(sound, body=body), recording, load_manifest("gimo"), with_jaw=True)
    assert track.joints.shape == (gimo_sample.N_FRAMES, len(JOINT_SETS[gimo.GIMO23].names), 3)
    assert np.array_equal(track.joints[:, :22], track.body)
    # The missing frame lies between its neighbours, and the jaw is carried into the room as the body is.
    steps = np.linalg.norm(np.diff(track.joints[:, 22], axis=0), axis=-1)
    assert steps == pytest.approx(np.ones(len(steps)))


def test_a_suit_has_no_jaw():
    readings = gimo_sample.readings()
    with pytest.raises(InputFileError, match="smpl22"):
        published_track(readings, gimo_sample.recording(readings), load_manifest("gimo"), with_jaw=True)


def test_which_joints_the_study_has_follows_from_the_options():
    model = Path("SMPLX_NEUTRAL.npz")
    decoder = Path("TR00_E096.pt")
    assert GimoReader(options=GimoOptions()).native_joints == "smpl22"
    assert GimoReader(options=GimoOptions(smplx_model=model, vposer_model=decoder)).native_joints == gimo.GIMO23
    assert (
        GimoReader(options=GimoOptions(smplx_model=model, vposer_model=decoder, body="bvh")).native_joints == "smpl22"
    )
