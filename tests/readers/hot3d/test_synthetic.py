"""Native HOT3D files: what is written comes back, in the form of the release."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from prbench.curation.in_hand import find_holdings
from prbench.protocol.manifests import load_manifest
from prbench.readers.hot3d import READER, read_readings
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d.files import read_glb
from prbench.readers.hot3d.synthetic import LAYOUT, box_mesh, clock_drift, frame_times, glb_bytes, sense
from prbench.readers.hot3d.to_recording import recording_from_hot3d
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors import Sensing, Switches


@pytest.fixture(scope="module")
def performance() -> Performance:
    return perform("hot3d", seed=11, index=6, n_events=1, provocations={})


@pytest.fixture(scope="module")
def readings(performance) -> hot3d.Hot3dReadings:
    return sense(performance, noise=2.0)


@pytest.fixture(scope="module")
def tree(readings, tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("hot3d") / "tree"
    LAYOUT.write(readings, root)
    LAYOUT.finish(root)
    return root


def test_headset_rows_are_rows_of_the_trajectory_at_the_nearest_millisecond(performance, readings) -> None:
    device = readings.mps.trajectory
    rows = {tuple(position): row for row, position in enumerate(np.hstack([device.position, device.rotation]).tolist())}
    stamped = np.hstack([readings.headset.position, readings.headset.rotation]).tolist()
    found = np.array([rows[tuple(pose)] for pose in stamped])
    since = (device.time_us[found] - device.time_us[0]) / 1e6
    assert np.abs(since - frame_times(performance)).max() <= 0.5e-3 + 1e-6


def test_rows_come_in_pairs_on_a_clock_of_their_own(performance, readings) -> None:
    step = np.diff(readings.headset.time_ns)
    assert np.abs(step[::2] - 91_000).max() <= 1  # rounded to whole nanoseconds on a clock that drifts
    drift = clock_drift(Sensing(performance, 2.0, Switches()))
    assert 0 < abs(drift) <= 2e-6
    length = (readings.headset.time_ns[-1] - readings.headset.time_ns[0]) / 1e9
    assert length / frame_times(performance)[-1] - 1 == pytest.approx(drift, abs=1e-9)


def test_rows_are_missing_in_runs(performance, readings) -> None:
    n = len(readings.headset.time_ns)
    missing = np.array([1 - len(entry.rows.time_ns) / n for entry in readings.objects])
    assert 0.02 < missing.mean() < 0.12, "6 % at twice the noise"
    ideal = sense(performance, noise=1.0, switches=replace(Switches(), object_gaps=False))
    assert {len(entry.rows.time_ns) for entry in ideal.objects} == {n}


def test_one_recording_of_five_begins_with_wrong_hands(performance) -> None:
    """Index 6 is one of them, and of a newer release, which says so in a mask."""
    wrong = sense(performance)
    right = sense(performance, switches=replace(Switches(), hand_start=False))
    elapsed = (wrong.hands[0].time_ns - wrong.headset.time_ns[0]) * 1e-9
    moved = np.linalg.norm(wrong.hands[0].position - right.hands[0].position, axis=1)
    clear = np.abs(elapsed - 0.7) > 1e-3  # hands and headset have clocks of their own
    assert moved[clear] == pytest.approx(np.where(elapsed[clear] < 0.7, 0.25, 0.0), abs=1e-6)
    times, good = wrong.masks["qa_pass"]
    assert np.array_equal(~good, times - times[0] < 0.7e9)
    assert right.masks["qa_pass"][1].all()
    recording = LAYOUT.recording(wrong)
    assert not recording.hands[0].valid[recording.hands[0].times < recording.span[0] + 0.69].any()


@pytest.mark.parametrize("turned", [False, True])
def test_models_come_back_through_scaled_and_turned_nodes(tmp_path, turned) -> None:
    mesh = box_mesh(np.array([0.03, 0.05, 0.08]))
    path = tmp_path / "1.glb"
    path.write_bytes(glb_bytes(mesh, name="box", turned=turned))
    back = read_glb(path)
    assert np.array_equal(back[0], mesh[0])
    assert np.array_equal(back[1], mesh[1])
    raw = next(iter(trimesh.load_scene(path, process=False).geometry.values())).vertices
    assert np.abs(raw).max() > 10, "millimetres below the node"


def test_the_library_has_the_keys_of_the_release(tree, samples) -> None:
    real = json.loads((samples / "hot3d" / "object_library" / "instance.json").read_text())
    written = json.loads((tree / "assets" / "instance.json").read_text())
    assert {frozenset(entry) for entry in written.values()} == {frozenset(entry) for entry in real.values()}
    assert sum(entry["instance_type"] == "headset" for entry in written.values()) == 1


@pytest.mark.usefixtures("open3d_or_slow_loop")
def test_the_surface_rule_finds_what_the_origin_rule_finds(tree) -> None:
    (found,) = READER.find(tree)
    recording = recording_from_hot3d(read_readings(found), load_manifest("hot3d"), dataset="hot3d", meshes=True)
    manifest = load_manifest("hot3d")
    times = {}
    for name in (None, "surface", "box"):
        rule = manifest.in_hand_rule(name)
        assert rule is not None
        picks = [holding.pick for holding in find_holdings(recording, rule) if holding.pick is not None]
        times[name] = [pick.time for pick in picks]
    assert len(times[None]) == 1
    assert times["surface"] == pytest.approx(times[None], abs=0.1)
    assert times["box"] == pytest.approx(times[None], abs=0.1)
