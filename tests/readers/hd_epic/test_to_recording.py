"""Streams of a video: the intermediate data's gaze and poses, and where gaze counts."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError, StreamsDoNotOverlap
from prbench.geometry.skeleton import Y_UP_FROM_Z_UP
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.format import device_from_cpf
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic.to_recording import glasses_streams, recording_from_hd_epic

MANIFEST = load_manifest("hd-epic")
THRESHOLDS = hd_epic.Thresholds(**MANIFEST.thresholds)
START = 7_000_000_000
N = 90


def _frames(**changes) -> hd_epic.FrameReadings:
    """Three seconds in which the glasses turn about the vertical and move; gaze every third frame, straight ahead."""
    tracking = START + np.rint(np.arange(N) * 1e9 / 30).astype(np.int64)
    poses = np.array([_pose(t) for t in (tracking - START) / 1e9])
    gaze_ns = tracking[np.arange(N) // 3 * 3] + 10_000_000  # 10 ms after the frame that shows it first
    ahead = device_from_cpf("DVT-S")[:3, 2]
    directions = np.array([pose[:, :3] @ ahead for pose in poses])
    frames = hd_epic.FrameReadings(tracking, tracking + 400_000, gaze_ns, poses, directions, "DVT-S", None)
    return dataclasses.replace(frames, **changes)


def _pose(seconds: float) -> np.ndarray:
    turn = Rotation.from_euler("z", 40 * seconds, degrees=True).as_matrix()
    return np.column_stack([turn, [0.5 * seconds, 0.0, 1.6]])


def _streams(frames, world=None):
    return glasses_streams(frames, THRESHOLDS, world_from_source=np.eye(4) if world is None else world)


def test_one_ray_a_distinct_gaze_time() -> None:
    gaze = _streams(_frames()).gaze
    assert len(gaze.times) == N / 3
    assert np.diff(gaze.times) == pytest.approx(0.1, abs=1e-6)


def test_a_ray_stands_at_the_time_of_the_gaze_and_not_of_the_frame() -> None:
    gaze = _streams(_frames()).gaze
    cpf = device_from_cpf("DVT-S")
    seconds = gaze.times[gaze.valid] - START / 1e9 - 0.0004  # poses are 0.4 ms later than their frames
    expected = np.array([_pose(t)[:, :3] @ cpf[:3, 2] for t in seconds])
    angle = np.rad2deg(np.arccos(np.clip((gaze.direction[gaze.valid] * expected).sum(axis=1), -1, 1)))
    assert angle.max() < 0.02, "10 ms at 40 deg/s are 0.4 deg"
    origin = np.array([_pose(t)[:, :3] @ cpf[:3, 3] + _pose(t)[:, 3] for t in seconds])
    assert gaze.origin[gaze.valid] == pytest.approx(origin, abs=2e-4)


def test_gaze_that_is_too_old_for_its_frame_is_invalid() -> None:
    frames = _frames()
    stale = frames.gaze_ns.copy()
    stale[30:33] -= 150_000_000  # 140 ms before its frames
    gaze = _streams(dataclasses.replace(frames, gaze_ns=stale)).gaze
    assert (~gaze.valid).sum() == 1
    assert gaze.times[~gaze.valid][0] == pytest.approx(7 + 1.0 + 0.01 - 0.15, abs=1e-6)


def test_frames_without_pose_leave_a_gap_that_gaze_does_not_bridge() -> None:
    frames = _frames()
    poses, slam = frames.world_from_device.copy(), frames.slam_ns.copy()
    poses[40:46], slam[40:46] = np.nan, -1
    streams = _streams(dataclasses.replace(frames, world_from_device=poses, slam_ns=slam))
    assert len(streams.device.times) == N - 6
    lost = streams.gaze.times[~streams.gaze.valid]
    assert ((lost > 7 + 39 / 30) & (lost < 7 + 46 / 30)).all()
    assert len(lost) >= 1
    assert "6 of 90 video frames have no pose of the glasses" in streams.messages


def test_without_any_pose_there_is_no_recording() -> None:
    frames = _frames(world_from_device=np.full((N, 3, 4), np.nan))
    with pytest.raises(InputFileError, match="expected poses of the glasses"):
        _streams(frames)


def test_the_world_is_turned_as_a_whole() -> None:
    frames, world = _frames(), Y_UP_FROM_Z_UP
    native, turned = _streams(frames), _streams(frames, world)
    assert turned.gaze.direction == pytest.approx(native.gaze.direction @ world[:3, :3].T)
    assert turned.head.position == pytest.approx(native.head.position @ world[:3, :3].T)


def _readings(frames, clock) -> hd_epic.HdEpicReadings:
    return hd_epic.HdEpicReadings("P09-x", "P09", clock, (), None, frames, None)


def test_gaze_outside_of_the_video_primes_nothing() -> None:
    frames = _frames()
    clock = hd_epic.VideoClock(frames.tracking_ns[30:60])
    gaze = recording_from_hd_epic(_readings(frames, clock), MANIFEST, dataset="hd-epic").gaze
    inside = (gaze.times >= 8.0) & (gaze.times <= 7 + 59 / 30 + 1 / 30)
    assert gaze.valid.tolist() == inside.tolist()


def test_clocks_that_do_not_meet_are_refused() -> None:
    frames = _frames()
    with pytest.raises(StreamsDoNotOverlap, match="video"):
        recording_from_hd_epic(
            _readings(frames, hd_epic.VideoClock(frames.tracking_ns // 1000)), MANIFEST, dataset="hd-epic"
        )


def _mps(confidence: float) -> mps.MpsReadings:
    """A second of still glasses, and a right wrist that is seen with one confidence."""
    time_us = START // 1000 + np.arange(0, 1_000_000, 1000)
    n, upright = len(time_us), np.array([1.0, 0.0, 0.0, 0.0])
    gaze_us = time_us[::100]
    angles, ranges = np.zeros(len(gaze_us)), np.zeros((len(gaze_us), 2))
    points = np.full((len(gaze_us), 2, 3), np.nan)
    points[:, 1] = (0.1, 0.2, 0.3)
    return mps.MpsReadings(
        mps.AriaTrajectory(
            time_us, np.zeros((n, 3)), np.tile(upright, (n, 1)), np.ones(n), np.array([0.0, 0.0, 1.0]), ("w",), 0
        ),
        mps.GazeAngles(gaze_us, angles, angles, angles, ranges, ranges),
        "general",
        mps.WristPositions(gaze_us, np.tile([-1.0, confidence], (len(gaze_us), 1)), points, points),
        "DVT-S",
        None,
    )


@pytest.mark.parametrize(("confidence", "counts"), [(0.69, False), (0.71, True)])
def test_only_surely_tracked_wrists_count(confidence, counts) -> None:
    streams = glasses_streams(_mps(confidence), THRESHOLDS, world_from_source=np.eye(4))
    left, right = streams.wrists
    assert not left.valid.any()
    assert right.valid[1:-1].all() == counts
    assert any("general gaze" in message for message in streams.messages)
