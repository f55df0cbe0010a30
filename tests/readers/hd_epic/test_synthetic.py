"""Synthetic HD-EPIC: sensors, annotations, and files that come back bit for bit."""

from __future__ import annotations

import dataclasses
import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest

from prbench.geometry.timelines import interpolate
from prbench.readers import reader_for
from prbench.readers.aria_mps import format as mps
from prbench.readers.hd_epic import format as hd_epic
from prbench.readers.hd_epic import synthetic as sensors
from prbench.readers.hd_epic.synthetic import LAYOUT
from prbench.synthetic.people import perform
from prbench.synthetic.people.perform import name_of_recording
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches
from prbench.synthetic.write_tree import synthesize_tree
from tests.comparing import differences

SEED, N_EVENTS, RECORDINGS = 2, 4, 2


@pytest.fixture(scope="module")
def performances() -> list[Performance]:
    return [perform("hd-epic", seed=SEED, index=index, n_events=N_EVENTS) for index in range(RECORDINGS)]


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("tree") / "root"
    synthesize_tree("hd-epic", root, recordings=RECORDINGS, seed=SEED, n_events=N_EVENTS)
    return root


def test_the_tree_has_the_datasets_folders_and_no_leftovers(tree) -> None:
    assert {path.name for path in tree.iterdir()} == {
        "HD-EPIC", "hd-epic-annotations", "egoallo", "smplh", "synthetic.json", "truth",
    }  # fmt: skip
    video, name = name_of_recording("hd-epic", SEED, 0), "3d_location"
    masks = json.loads((tree / "hd-epic-annotations/scene-and-object-movements/mask_info.json").read_text())
    assert set(masks) == {name_of_recording("hd-epic", SEED, index) for index in range(RECORDINGS)}
    assert all(len(mask[name]) == 3 for mask in masks[video].values())


def test_ideal_sensors_tell_the_truth(performances) -> None:
    performance = performances[0]
    recording = LAYOUT.recording(LAYOUT.sense(performance, noise=0.0))
    offset = LAYOUT.clock_start(performance) - performance.times[0]
    truth = LAYOUT.events(performance)
    assert len(truth) == len(recording.annotated_events) > 0
    for event, annotated in zip(truth, recording.annotated_events, strict=True):
        assert annotated.event_time == pytest.approx(event.event_time + offset, abs=6e-4)
        assert annotated.location == pytest.approx(event.goal, abs=1e-6)
        assert annotated.action == event.action
        assert annotated.object_id == LAYOUT.object_id(event.object_id)
    times = recording.gaze.times - offset
    gaze = interpolate(performance.times, performance.gaze, times)
    angle = np.arccos(np.clip((gaze * recording.gaze.direction).sum(axis=1) / np.linalg.norm(gaze, axis=1), -1, 1))
    assert np.median(angle) < 1e-4
    joints = interpolate(performance.times, performance.joints, recording.body.times - offset)
    assert np.linalg.norm(joints - recording.body.joints, axis=-1).max() < 2e-3


def test_annotated_times_and_points_err_as_much_as_specified() -> None:
    times, points, lost, n = [], [], 0, 0
    for index in range(7):
        performance = perform("hd-epic", seed=77, index=index, n_events=6, rate=30.0, provocations={})
        sensing = Sensing(performance, 1.0, Switches())
        tracks = sensors._annotated_tracks(sensing, sensors.sense_video_clock(sensing))
        pairs = sorted(sensors.movements(performance), key=lambda pair: pair[0].event_time)
        for track, (pick, put) in zip(tracks, pairs, strict=True):
            times += [track.start - pick.event_time, track.end - put.event_time]
            masks = {mask.frame: mask for mask in track.masks}
            for seconds, event in ((track.start, pick), (track.end, put)):
                n += 1
                mask = masks.get(round(seconds * hd_epic.FPS))
                lost += mask is None
                if mask is not None:
                    x, y, z = mask.location
                    points.append(np.array([x, z, -y]) - event.goal)
    assert np.std(times) == pytest.approx(0.060, rel=0.25)
    assert np.std(points) == pytest.approx(0.020, rel=0.2)
    assert lost / n < 0.15


def test_repeated_and_skipped_images() -> None:
    performance = perform("hd-epic", seed=5, index=0, n_events=6, rate=30.0)
    clock = sensors.sense_video_clock(Sensing(performance, 20.0, Switches()))
    steps = np.diff(clock.device_ns)
    assert clock.repeats > 0
    assert (steps >= 0).all()
    assert (steps > 1.5e9 / 30).sum() > 0
    assert sensors.sense_video_clock(Sensing(performance, 0.0, Switches())).repeats == 0


def test_videos_of_one_participant_share_a_world(performances) -> None:
    first = performances[0]
    guest = dataclasses.replace(first, recording_id="hd-epic_synthetic_seed2_0009", index=9)
    other = dataclasses.replace(guest, person=dataclasses.replace(first.person, participant_id="S999"))

    def worlds(performance):
        return LAYOUT.sense(performance).readings.glasses.trajectory.graph_uids

    assert worlds(first) == worlds(guest) != worlds(other)


def test_gaze_is_general_and_archives_hold_what_the_dataset_has(tree) -> None:
    (archive,) = tree.glob(f"HD-EPIC/SLAM-and-Gaze/*/GAZE_HAND/mps_{name_of_recording('hd-epic', SEED, 0)}_vrs.zip")
    with zipfile.ZipFile(archive) as opened:
        names = {name.rpartition("/")[2] for name in opened.namelist()}
    assert names == {"general_eye_gaze.csv", mps.WRISTS_FILE, mps.SUMMARY_FILE}


def test_the_priming_file_comes_from_another_rule(performances) -> None:
    outcomes = [
        entry.frame_primed for performance in performances for entry in LAYOUT.sense(performance).readings.priming
    ]
    assert any(value >= 0 for value in outcomes)
    assert len(outcomes) > 5


def test_a_copy_without_the_truth_reads_the_same(tree, tmp_path) -> None:
    copy = shutil.copytree(tree, tmp_path / "root", ignore=shutil.ignore_patterns("truth"))
    reader = reader_for("hd-epic")
    one, other = (reader.read(reader.find(root)[0]) for root in (tree, copy))
    assert not list(differences(one, other))
