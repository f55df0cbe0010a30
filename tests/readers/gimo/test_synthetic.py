"""Synthetic GIMO: files and memory agree, bytes repeat, and the truth is what the dataset can know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.geometry.skeleton import WRISTS
from prbench.geometry.timelines import interpolate
from prbench.readers import reader_for
from prbench.readers.gimo.synthetic import LAYOUT, sense
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from prbench.synthetic.write_tree import synthesize_tree


@pytest.fixture(scope="module")
def performance() -> Performance:
    return perform("gimo", seed=11, index=0, n_events=2, provocations={})


@pytest.fixture(scope="module")
def tree(tmp_path_factory):
    root = tmp_path_factory.mktemp("gimo") / "tree"
    synthesize_tree("gimo", root, recordings=2, seed=11, n_events=2, provocations={})
    return root


def test_the_table_is_as_real_copies_have_it(tree) -> None:
    content = (tree / "dataset.csv").read_bytes()
    assert content.startswith(b"\xef\xbb\xbfsequence_path,")
    lines = content.decode("utf-8-sig").splitlines()
    assert lines[0].endswith("training,action,,,")
    assert len(lines) == 4
    assert lines[-1] == lines[-2], "one row is repeated"
    reader = reader_for("gimo")
    assert "line 3 of dataset.csv is repeated in line 4" in reader.read(reader.find(tree)[1]).messages[0]


def test_with_ideal_sensors_the_body_is_the_truth(performance) -> None:
    recording = LAYOUT.recording(sense(performance, noise=0.0))
    offset = float(performance.times[0]) - LAYOUT.clock_start(performance)
    true = interpolate(performance.times, performance.joints, recording.body.times + offset)
    np.testing.assert_allclose(recording.body.joints, true, atol=5e-5)
    assert recording.gaze.valid.all()


def test_gaze_points_lie_on_the_ray_and_on_something(performance) -> None:
    recording = LAYOUT.recording(sense(performance, noise=0.0))
    offset = float(performance.times[0]) - LAYOUT.clock_start(performance)
    eye = interpolate(performance.times, performance.eye, recording.gaze.times + offset)
    gaze = interpolate(performance.times, performance.gaze, recording.gaze.times + offset)
    room_from_scan = recording.world_from_source
    points = sense(performance, noise=0.0).gaze.points @ room_from_scan[:3, :3].T + room_from_scan[:3, 3]
    along = ((points - eye) * gaze).sum(axis=1)
    np.testing.assert_allclose(points, eye + along[:, None] * gaze, atol=1e-3)
    assert along.min() > 0.05
    assert along.max() < 10


def test_rooms_share_their_scan() -> None:
    pair = [perform("gimo", seed=11, index=index, n_events=1, provocations={}) for index in (0, 1)]
    same = [replace(each, room_id="R000") for each in pair]
    first, second = (sense(each).transform for each in same)
    np.testing.assert_array_equal(first.room_from_scene, second.room_from_scene)
    assert first.scale == second.scale
    assert not np.array_equal(first.scene_from_body, second.scene_from_body)


def test_true_goals_are_wrists_on_annotated_frames(performance) -> None:
    recording = LAYOUT.recording(sense(performance, noise=0.0))
    true = LAYOUT.events(performance)
    assert len(true) == len(recording.annotated_events) == 2
    for event, found in zip(true, recording.annotated_events, strict=True):
        assert event.action == "pick"
        np.testing.assert_allclose(found.location, event.goal, atol=1e-4)
        since = np.array([event.event_time])
        wrist = interpolate(performance.times, performance.joints[:, WRISTS[event.hand == "right"]], since)[0]
        assert np.linalg.norm(wrist - event.goal) < 0.02


def test_doors_and_near_events_are_not_annotated() -> None:
    provoked = perform("gimo", seed=11, index=2, n_events=4, provocations={"hinge": 0.3, "touch": 0.3, "pass_by": 0.3})
    tags = {event.tag for event in provoked.events}
    assert tags & {"hinge", "touch", "pass_by"}
    assert not {event.tag for event in LAYOUT.events(provoked)} & {"hinge", "touch", "pass_by"}
