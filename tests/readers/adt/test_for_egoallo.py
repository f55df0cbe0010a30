"""Aria Digital Twin with bodies that EgoAllo estimated: only the body differs from the suit's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.curation.events import find_events
from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import interpolate
from prbench.protocol.manifests import load_manifest
from prbench.readers import reader_for
from prbench.readers.adt import format as adt
from prbench.readers.adt.synthetic import estimated_outputs, write
from prbench.readers.adt.to_recording import ASSUMED_SIZE, prepared_trajectory, recording_from_adt, turned_to_z_up
from prbench.readers.aria_mps.format import device_from_cpf
from prbench.readers.aria_mps.to_recording import part_poses
from prbench.readers.egoallo.files import poses_folder
from prbench.readers.egoallo.synthetic import synthetic_smplh, write_outputs, write_smplh_model
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.recording import Recording
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Switches
from tests.comparing import differences


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def performance():
    return perform("adt", seed=11, index=3, n_events=2, provocations={})


@pytest.fixture(scope="module")
def readings(performance):
    return layout_for("adt").sense(performance, switches=replace(Switches(), pose_losses=False))


@pytest.fixture
def root(tmp_path, performance, readings) -> Path:
    write(readings, tmp_path / "ADT" / readings.recording_id)
    write_outputs(estimated_outputs(performance, readings), poses_folder(tmp_path / "ADT", readings.recording_id))
    write_smplh_model(tmp_path / "ADT" / "smplh" / "neutral" / "model.npz")
    return tmp_path / "ADT"


def _read(root: Path, **options: str) -> Recording:
    reader = reader_for("adt", options)
    (found,) = reader.find(root)
    return reader.read(found)


def test_only_the_body_differs_from_the_suits(root):
    suit, estimated = _read(root), _read(root, poses="egoallo")
    assert {path.split(".")[1] for path in differences(suit, estimated)} == {"body", "pose_source", "head_tilt_deg"}
    assert (suit.pose_source, suit.head_tilt_deg) == ("adt-optitrack", 7.4)
    assert (estimated.pose_source, estimated.head_tilt_deg) == ("egoallo", 38.3)


def test_events_are_the_same_as_with_the_suit(root):
    rule = load_manifest("adt").in_hand
    suit, estimated = (tuple(find_events(_read(root, poses=poses), rule)[0]) for poses in ("native", "egoallo"))
    assert len(suit) == 2
    assert not list(differences(suit, estimated))


def test_bodies_come_back_into_the_scene(root, performance, readings):
    body = _read(root, poses="egoallo").body
    assert body is not None
    true = interpolate(performance.times, performance.joints, body.times - readings.glasses.time_us[0] / 1e6)
    errors = np.linalg.norm(body.joints - true, axis=2)
    assert errors[:, Joint.NECK].max() < 0.04  # Z up taken for Y up would be metres off
    assert np.median(errors) < 0.03


def test_files_and_memory_hold_the_same(root, performance, readings):
    body = body_from_outputs(estimated_outputs(performance, readings), synthetic_smplh())
    in_memory = recording_from_adt(
        replace(readings, estimated_body=body), load_manifest("adt"), dataset="adt", poses="egoallo"
    )
    assert not list(differences(in_memory, _read(root, poses="egoallo")))


def test_without_outputs_there_is_no_body_and_the_message_says_what_to_run(root):
    for path in (root / "egoallo").rglob("*.npz"):
        path.unlink()
    recording = _read(root, poses="egoallo")
    assert recording.body is None
    assert recording.pose_source == "none"
    assert any("prbench poses egoallo" in message for message in recording.messages)
    assert recording.hands


def test_outputs_made_from_the_y_up_trajectory_are_refused(root, performance, readings):
    for output in estimated_outputs(performance, readings):
        lying = output.world_from_cpf.copy()
        lying[:, 4:] = lying[:, 4:] @ adt.Z_UP_FROM_SCENE[:3, :3].astype(np.float32)
        write_outputs([replace(output, world_from_cpf=lying)], poses_folder(root, readings.recording_id))
    with pytest.raises(InputFileError, match="another recording or world"):
        _read(root, poses="egoallo")


def test_frames_over_a_gap_of_the_glasses_are_invalid(performance, readings):
    glasses = readings.glasses
    start = glasses.time_us[0] / 1e6
    kept = (glasses.time_us / 1e6 < start + 3.0) | (glasses.time_us / 1e6 > start + 4.0)
    gap = replace(
        glasses,
        time_us=glasses.time_us[kept],
        position=glasses.position[kept],
        rotation=glasses.rotation[kept],
        quality=glasses.quality[kept],
    )
    body = body_from_outputs(estimated_outputs(performance, readings), synthetic_smplh())
    recording = recording_from_adt(
        replace(readings, glasses=gap, estimated_body=body), load_manifest("adt"), dataset="adt", poses="egoallo"
    )
    assert recording.body is not None
    within = (recording.body.times > start + 3.0) & (recording.body.times < start + 3.95)
    assert not recording.body.valid[within].any()
    assert recording.body.valid[~within].mean() > 0.98


def test_the_prepared_trajectory_is_the_same_path_every_millisecond_with_z_up(readings):
    prepared = prepared_trajectory(readings.glasses)
    assert (np.diff(prepared.time_us) == 1000).all()
    exact = np.isin(prepared.time_us, readings.glasses.time_us)
    there = np.isin(readings.glasses.time_us, prepared.time_us)
    native = readings.glasses.position[there]
    np.testing.assert_allclose(prepared.position[exact], native[:, [0, 2, 1]] * (1, -1, 1), atol=1e-9)
    assert abs(np.median(prepared.position[:, 2]) - np.median(readings.glasses.position[:, 1])) < 1e-2
    cpf = part_poses(turned_to_z_up(readings.glasses), device_from_cpf(ASSUMED_SIZE))
    assert np.median(cpf.position[:, 2]) > 1.2
