"""Sensors and files of the Machine Perception Services: every error stands alone, files hold what was sensed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic import GAZE_BIAS, sense_mps, write_mps
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Sensing, Switches, gaze_bias_of

START_US = 90_000_000_000


@pytest.fixture(scope="module")
def performance():
    return perform("hd-epic", seed=5, index=2, n_events=2, provocations={})


def sense(performance, **options) -> mps.MpsReadings:
    return sense_mps(performance, start_us=START_US, step_jitter_us=2, **options)


def test_errors_have_the_sizes_of_the_page(performance) -> None:
    ideal, noisy = sense(performance, noise=0.0), sense(performance, switches=replace(Switches(), pose_clock=False))
    steady = replace(Switches.ideal(), pose_noise=True)
    white = sense(performance, switches=steady).trajectory.position - ideal.trajectory.position
    assert white.std() == pytest.approx(0.2e-3, rel=0.05)
    wander = noisy.trajectory.position - ideal.trajectory.position
    assert 1e-3 < np.sqrt((wander**2).mean()) < 12e-3  # 5 mm r.m.s. over minutes; a short recording sees a part of it
    turned = (
        Rotation.from_quat(noisy.trajectory.rotation, scalar_first=True)
        * Rotation.from_quat(ideal.trajectory.rotation, scalar_first=True).inv()
    )
    assert 0.02 < np.rad2deg(turned.magnitude()).mean() < 1.5


def test_steps_of_the_clock(performance) -> None:
    assert set(np.diff(sense(performance, switches=Switches.ideal()).trajectory.time_us)) == {1000}
    steps = np.diff(sense(performance).trajectory.time_us)
    assert steps.min() >= 996
    assert steps.max() <= 1004
    assert len(set(steps.tolist())) > 3
    gaze = np.diff(sense(performance, switches=replace(Switches(), gaze_losses=False)).gaze.time_us)
    assert np.abs(gaze - 100_000).max() <= 32


def test_general_gaze_is_biased_two_and_a_half_times_as_much(performance) -> None:
    own = np.array(gaze_bias_of(Sensing(performance, 1.0, Switches()), GAZE_BIAS["personalized"]))
    general = np.array(gaze_bias_of(Sensing(performance, 1.0, Switches()), GAZE_BIAS["general"]))
    assert general == pytest.approx(2.5 * own)
    only_bias = replace(Switches.ideal(), gaze_bias=True)
    ideal, biased = (sense(performance, switches=on, gaze_kind="general") for on in (Switches.ideal(), only_bias))
    assert (biased.gaze.yaw - ideal.gaze.yaw).mean() == pytest.approx(general[0], abs=1e-6)
    assert biased.gaze_kind == "general"


def test_the_native_world_is_z_up_and_upright(performance) -> None:
    trajectory = sense(performance, noise=0.0).trajectory
    assert trajectory.up.tolist() == [0, 0, 1]
    assert 0.8 < np.median(trajectory.position[:, 2]) < 2.0  # eye height


def test_gaps_are_made_where_they_are_asked_for(performance) -> None:
    broken = sense(performance, slam_gaps=[(2.0, 2.5)]).trajectory
    whole = sense(performance).trajectory
    step = np.diff(broken.time_us)
    assert (step > 50_000).sum() == 1
    assert step.max() == pytest.approx(500_000, abs=2_010)
    assert np.isin(broken.time_us, whole.time_us).all()


def test_velocities_are_written_though_nobody_reads_them(performance, tmp_path) -> None:
    readings = sense(performance, noise=0.0)
    write_mps(readings, tmp_path, only={mps.TRAJECTORY})
    lines = (tmp_path / "slam" / "closed_loop_trajectory.csv").read_text().splitlines()
    names = lines[0].split(",")
    rows = np.array([[float(cell or "nan") for cell in line.split(",")[1:]] for line in lines[1000:1200]])
    velocity = rows[:, [names.index(f"device_linear_velocity_{axis}_device") - 1 for axis in "xyz"]]
    position = readings.trajectory.position[999:1200]
    speed = np.linalg.norm(np.diff(position, axis=0), axis=1) / np.diff(readings.trajectory.time_us[999:1200]) * 1e6
    assert np.linalg.norm(velocity, axis=1) == pytest.approx(speed, abs=2e-6)
    assert {"utc_timestamp_ns", "geo_available", "qw_ecef_device"} <= set(names)
