"""The sample output against the values that EgoAllo's own kinematics gave."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.readers.egoallo.bodies import read_smplh_rest, read_window
from prbench.readers.egoallo.files import read_output
from prbench.readers.egoallo.format import EgoAlloOutput, forward_kinematics

NAME = "egoallo/egoallo_outputs/20240101-120000_0-12.npz"
MODEL = "egoallo/mock_smplh/neutral/model.npz"


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))


def test_shape(samples, reference_values):
    expected = reference_values["egoallo-shape"]["expect"]
    output = read_output(samples / NAME)
    window, _ = read_window(samples / NAME, samples / MODEL)
    assert isinstance(output, EgoAlloOutput)
    assert window.samples == expected["samples"]
    assert window.joints.shape == (expected["frames"], expected["joints"], 3)
    assert [int(window.time_ns[0]), int(window.time_ns[-1])] == [expected["first_ns"], expected["last_ns"]]


def test_joints_of_the_first_frame_with_its_own_shape(samples, reference_values):
    item = reference_values["egoallo-joints-0"]
    output, rest = read_output(samples / NAME), read_smplh_rest(samples / MODEL)
    assert isinstance(output, EgoAlloOutput)
    joints = forward_kinematics(
        rest.rest_joints(output.betas[0, 0]),
        output.world_from_root[0, :1, 4:].astype(np.float64),
        output.world_from_root[0, :1, :4].astype(np.float64),
        output.body_quats[0, :1].astype(np.float64),
    )
    np.testing.assert_allclose(joints[0], item["expect"]["joints"], atol=1e-6)


def test_joints_with_the_mean_shape_keep_their_bones_and_stay_near(samples, reference_values):
    window, _ = read_window(samples / NAME, samples / MODEL)
    expected = np.array(reference_values["egoallo-joints-0"]["expect"]["joints"])
    assert np.linalg.norm(window.joints[0] - expected, axis=1).max() < 0.05  # only the shape differs
    bones = np.linalg.norm(np.diff(window.joints[:, [1, 4, 7, 10]], axis=1), axis=2)
    assert np.ptp(bones, axis=0).max() < 1e-5
