"""EgoAllo-like bodies: written, read, and as far from the truth as they should be."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Joint, bone_lengths, head_forward, invert_rigid
from prbench.geometry.timelines import interpolate, slerp
from prbench.protocol.manifests import load_manifest
from prbench.readers.aria_mps.format import AriaTrajectory, device_from_cpf
from prbench.readers.egoallo.bodies import read_bodies, read_smplh_rest
from prbench.readers.egoallo.files import find_outputs
from prbench.readers.egoallo.format import EgoAlloBody
from prbench.readers.egoallo.synthetic import (
    NATIVE_FROM_WORLD,
    sense_egoallo,
    synthetic_smplh,
    write_outputs,
    write_smplh_model,
)
from prbench.readers.egoallo.to_recording import body_from_outputs, body_stream
from prbench.readers.found import RecordingFiles
from prbench.recording import PoseStream
from prbench.synthetic.people import perform
from prbench.synthetic.sensors import Switches
from tests.comparing import differences

START_US = 150_000_000


def _trajectory(performance) -> AriaTrajectory:
    """Ideal 1 kHz poses of the glasses, Z up."""
    times = performance.times[0] + np.arange(int(performance.duration * 1000)) / 1000
    head = slerp(performance.times, performance.head_rotation, times)
    cpf = Rotation.from_matrix(NATIVE_FROM_WORLD[:3, :3]) * Rotation.from_quat(head, scalar_first=True)
    eye = interpolate(performance.times, performance.eye, times) @ NATIVE_FROM_WORLD[:3, :3].T
    cpf_device = invert_rigid(device_from_cpf("DVT-S"))
    rotation = cpf * Rotation.from_matrix(cpf_device[:3, :3])
    return AriaTrajectory(
        time_us=START_US + np.arange(len(times)) * 1000,
        position=eye + cpf.apply(cpf_device[:3, 3]),
        rotation=rotation.as_quat(scalar_first=True),
        quality=np.ones(len(times)),
        up=np.array([0.0, 0, 1]),
        graph_uids=("world",),
        left_out=0,
    )


@pytest.fixture(scope="module")
def person():
    return perform("hd-epic", seed=11, index=3, n_events=3, provocations={})


@pytest.fixture(scope="module")
def trajectory(person):
    return _trajectory(person)


def _body(outputs) -> EgoAlloBody:
    body = body_from_outputs(outputs, synthetic_smplh())
    assert body is not None
    return body


def _errors(person, outputs) -> np.ndarray:
    """Distance of every joint from the truth at the same time."""
    stream = body_stream(_body(outputs), world_from_source=NATIVE_FROM_WORLD.T)
    assert stream.valid.all()
    times = stream.times - START_US / 1e6
    return np.linalg.norm(stream.joints - interpolate(person.times, person.joints, times), axis=2)


@pytest.mark.parametrize("preset", ["hd-epic", "hot3d", "adt"])
def test_an_ideal_estimate_is_the_truth(preset):
    person = perform(preset, seed=5, index=1, n_events=1, provocations={})
    outputs = sense_egoallo(person, _trajectory(person), switches=Switches.ideal())
    errors = _errors(person, outputs)
    if preset == "adt":  # a body model's head joint, not the suit's
        assert errors[:, Joint.HEAD].min() > 0.04
        assert errors[:, Joint.HEAD].max() < 0.09
        errors = np.delete(errors, Joint.HEAD, axis=1)
    # Between frames of the truth a turning limb is interpolated along its arc here, along the chord there.
    assert np.median(errors) < 1e-5
    assert errors.max() < 4e-3


@pytest.mark.parametrize("preset", ["hd-epic", "adt"])
def test_the_head_tilt_of_the_model_shows_where_the_head_looks(preset):
    person = perform(preset, seed=5, index=1, n_events=1, provocations={})
    body = _body(sense_egoallo(person, _trajectory(person), switches=Switches.ideal()))
    stream = body_stream(body, world_from_source=NATIVE_FROM_WORLD.T)
    times = stream.times - START_US / 1e6
    seen, _ = head_forward(stream.joints, 38.3)
    native, _ = head_forward(interpolate(person.times, person.joints, times), load_manifest("adt").body.head_tilt_deg)
    if preset == "adt":  # the suit's own bone under this tilt would be 31 degrees off
        between = np.rad2deg(np.arccos(np.clip((seen * native).sum(axis=1), -1, 1)))
        assert between.mean() < 6
    head = Rotation.from_quat(slerp(person.times, person.head_rotation, times), scalar_first=True)
    assert (seen * head.apply([0.0, 0, 1])).sum(axis=1).mean() > np.cos(np.deg2rad(20))


def test_default_errors_are_those_of_the_page(person, trajectory):
    outputs = sense_egoallo(person, trajectory)
    errors = _errors(person, outputs)
    assert errors[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]].max() < 0.021
    feet = np.sqrt((errors[:, [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]] ** 2).mean())
    assert 0.015 < feet < 0.035
    assert 0.002 < np.sqrt((errors[:, Joint.PELVIS] ** 2).mean()) < 0.025
    assert 0.005 < errors[:, [Joint.LEFT_ELBOW, Joint.RIGHT_ELBOW]].mean() < 0.05


def test_bones_keep_the_persons_lengths_whatever_the_noise(person, trajectory):
    body = _body(sense_egoallo(person, trajectory, noise=2.0))
    expected = bone_lengths(person.joints[0])
    np.testing.assert_allclose(
        bone_lengths(body.joints.astype(np.float64)), np.tile(expected, (len(body.joints), 1)), atol=5e-6
    )


def test_windows_overlap_by_32_frames_of_33_ms_and_the_head_is_exact(person, trajectory):
    outputs = sense_egoallo(person, trajectory)
    assert len(outputs) > 3
    assert all(len(output.time_ns) == 128 for output in outputs[:-1])
    assert all((np.diff(output.time_ns) == 33_000_000).all() for output in outputs)
    for earlier, later in itertools.pairwise(outputs):
        shared = np.isin(later.time_ns, earlier.time_ns)
        assert shared.sum() == min(32, len(later.time_ns))
    assert outputs[0].time_ns[0] == (START_US + 33_000) * 1000  # the first pose has no predecessor
    eye = interpolate(person.times, person.eye, outputs[1].time_ns / 1e9 - START_US / 1e6) @ NATIVE_FROM_WORLD[:3, :3].T
    np.testing.assert_allclose(outputs[1].world_from_cpf[:, 4:], eye, atol=1e-5)


def test_written_and_read_back_the_joints_are_those_in_memory(person, trajectory, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    outputs = sense_egoallo(person, trajectory)
    write_outputs(outputs, tmp_path / "rec" / "egoallo_outputs")
    write_smplh_model(tmp_path / "smplh" / "neutral" / "model.npz")
    found = RecordingFiles("hd-epic", "rec", tmp_path / "rec", find_outputs(tmp_path, tmp_path / "rec", "rec"))
    rotation = Rotation.from_quat(trajectory.rotation, scalar_first=True)
    position = trajectory.position + rotation.apply(device_from_cpf("DVT-S")[:3, 3])
    cpf = PoseStream(trajectory.time_us / 1e6, position, trajectory.rotation, trajectory.quality > 0)
    for _ in range(2):  # computed, then taken from the cache
        read = read_bodies(found, cpf=cpf)
        assert not list(differences(_body(outputs), read))


def test_the_written_model_has_the_keys_of_smplh_and_the_same_rest_joints(tmp_path):
    write_smplh_model(tmp_path / "model.npz")
    with np.load(tmp_path / "model.npz", allow_pickle=False) as model:
        assert set(model.files) == {
            "f", "J_regressor", "kintree_table", "weights", "posedirs", "v_template", "shapedirs",
        }  # fmt: skip
        assert model["kintree_table"][0, 0] == 2**32 - 1
        assert model["J_regressor"].shape[0] == 52
        assert model["shapedirs"].shape[2] == 16
    assert not list(differences(read_smplh_rest(tmp_path / "model.npz"), synthetic_smplh()))
