"""Streams from what the Machine Perception Services say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.geometry.skeleton import Y_UP_FROM_Z_UP
from prbench.geometry.timelines import interpolate
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import read_gaze_angles, read_size_and_camera, read_trajectory, read_wrists
from prbench.readers.aria_mps.synthetic import sense_mps, with_slam_gaps
from prbench.readers.aria_mps.to_recording import MpsStreams, mps_streams
from prbench.synthetic.people import perform

START_US = 7_000_000_321


@pytest.fixture(scope="module")
def performance():
    return perform("hd-epic", seed=3, index=1, n_events=1, provocations={})


@pytest.fixture(scope="module")
def readings(performance) -> mps.MpsReadings:
    return sense_mps(performance, start_us=START_US, step_jitter_us=2)


def streams(readings: mps.MpsReadings, **options) -> MpsStreams:
    return mps_streams(readings, world_from_source=Y_UP_FROM_Z_UP, **options)


def assert_same_gaze(one: MpsStreams, other: MpsStreams) -> None:
    for name in ("times", "origin", "direction", "valid"):
        assert np.array_equal(getattr(one.gaze, name), getattr(other.gaze, name)), name


def test_ideal_sensors_say_the_truth(performance) -> None:
    ideal = sense_mps(performance, start_us=START_US, noise=0.0)
    found = streams(mps.thinned(ideal))
    before = START_US / 1e6 - performance.times[0]
    head = interpolate(performance.times, performance.eye, found.head.times - before)
    assert np.abs(found.head.position - head).max() < 2e-6  # rounding of the files
    gaze = interpolate(performance.times, performance.gaze, found.gaze.times - before)
    assert np.abs(found.gaze.direction - gaze).max() < 0.01  # chords of saccades at 120 Hz
    for side, joint in enumerate((20, 21)):
        true = interpolate(performance.times, performance.joints[:, joint], found.wrists[side].times - before)
        assert found.wrists[side].valid.all()
        assert np.abs(found.wrists[side].points[:, 0] - true).max() < 5e-3


def test_rays_are_the_same_from_all_poses_or_from_those_around_them(readings) -> None:
    assert_same_gaze(streams(readings), streams(mps.thinned(readings)))


def test_gaps_of_tracking_are_never_bridged(readings) -> None:
    spans = [(START_US + 1_000_000, START_US + 1_400_000), (START_US + 2_000_000, START_US + 2_030_000)]
    broken = with_slam_gaps(readings, spans)
    whole, thin = streams(broken), streams(mps.thinned(broken))
    assert_same_gaze(whole, thin)
    times = thin.gaze.times - START_US / 1e6
    inside = (times > 1.002) & (times < 1.398)
    assert inside.sum() >= 3
    assert not thin.gaze.valid[inside].any()
    near = (times > 1.998) & (times < 2.032)  # 30 ms are no gap
    assert np.array_equal(thin.gaze.valid[near], streams(readings).gaze.valid[near])
    for one, other in zip(whole.wrists, thin.wrists, strict=True):
        assert np.array_equal(one.valid, other.valid)
        gap = (one.times - START_US / 1e6 > 1.002) & (one.times - START_US / 1e6 < 1.398)
        assert not one.valid[gap].any()


def test_gaps_and_gaze_outside_of_the_tracked_time_are_told(readings) -> None:
    assert not any("gap" in message or "outside" in message for message in streams(readings).messages)
    early = with_slam_gaps(readings, [(START_US - 1, START_US + 500_001), (START_US + 1_000_000, START_US + 1_400_500)])
    said = streams(mps.thinned(early)).messages
    assert any(message == "gaps in the poses of the glasses, not bridged: 1, the longest 0.40 s" for message in said)
    assert any(message.startswith("5 of ") and "outside the tracked time" in message for message in said)


def test_thinning_makes_no_gap_and_hides_none(readings) -> None:
    broken = with_slam_gaps(readings, [(START_US + 1_000_000, START_US + 1_060_000)])
    steps = np.diff(mps.thinned(broken).trajectory.time_us)
    assert (steps > 50_000).sum() == 1
    assert steps.max() == pytest.approx(61_000, abs=1_100)


def test_poor_poses_are_invalid(readings) -> None:
    quality = np.where(np.arange(len(readings.trajectory.quality)) < 1500, 0.49, 1.0)
    poor = streams(replace(readings, trajectory=replace(readings.trajectory, quality=quality)))
    early = poor.gaze.times < (START_US + 1_400_000) / 1e6
    assert not poor.gaze.valid[early].any()
    assert poor.gaze.valid[~early].any()
    assert any("quality below 0.5" in message for message in poor.messages)


def test_hands_need_confidence_and_a_position(readings) -> None:
    assert readings.wrists is not None
    for side in (0, 1):
        every, sure = streams(readings).wrists[side], streams(readings, least_confidence=0.7).wrists[side]
        confidence = readings.wrists.confidence[:, side]
        assert np.array_equal(every.valid, confidence > 0)
        assert np.array_equal(sure.valid, confidence > 0.7)
        assert 0 < sure.valid.sum() < every.valid.sum() < len(every.valid)


def test_the_world_is_the_callers(readings) -> None:
    moved = np.eye(4)
    moved[:3, 3] = (1.0, 2.0, 3.0)
    away = mps_streams(readings, world_from_source=moved @ Y_UP_FROM_Z_UP)
    assert away.camera.position == pytest.approx(np.add(streams(readings).camera.position, (1.0, 2.0, 3.0)))
    assert away.gaze.direction == pytest.approx(streams(readings).gaze.direction)


def test_unknown_glasses_are_assumed_small_and_said_so(readings) -> None:
    unknown = streams(replace(readings, glasses_size=None, gaze_kind="general"))
    assert_same_gaze(unknown, streams(readings))
    assert any("DVT-S assumed" in message for message in unknown.messages)
    assert any("general gaze" in message for message in unknown.messages)


def test_a_ray_and_a_wrist_of_the_sample(samples, reference_values) -> None:
    sample = samples / "mps" / "mps_sample"
    size, device_from_rgb = read_size_and_camera(sample / "trajectory/online_calibration.jsonl")
    found = mps_streams(
        mps.thinned(
            mps.MpsReadings(
                trajectory=read_trajectory(sample / "trajectory/closed_loop_trajectory.csv"),
                gaze=read_gaze_angles(sample / "eye_gaze_vergence/generalized_gaze.csv"),
                gaze_kind="general",
                wrists=read_wrists(sample / "hand_tracking/wrist_and_palm_poses.csv"),
                glasses_size=size,
                device_from_rgb=device_from_rgb,
            )
        ),
        world_from_source=np.eye(4),
    )
    ray = reference_values["mps-gaze-world-50"]["expect"]
    assert found.gaze.origin[50] == pytest.approx(ray["origin_world"], abs=5e-4)
    assert found.gaze.direction[50] == pytest.approx(ray["direction_world"], abs=5e-4)
    wrist = reference_values["mps-wrist-109"]["expect"]
    assert found.wrists[1].points[109, 0] == pytest.approx(wrist["wrist_world"], abs=1e-3)
    assert found.wrists[1].valid.sum() == 6
