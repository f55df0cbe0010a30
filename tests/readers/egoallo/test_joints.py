"""The sample output against the values that EgoAllo's own kinematics gave."""

from __future__ import annotations

import numpy as np

from prbench.readers.egoallo.bodies import read_output, read_smplh_rest
from prbench.readers.egoallo.format import EgoAlloBody
from prbench.readers.egoallo.to_recording import body_from_outputs
from prbench.representation.converters.smpl import pose_body

NAME = "egoallo/egoallo_outputs/20240101-120000_0-12.npz"
MODEL = "egoallo/mock_smplh/neutral/model.npz"


def _body(samples) -> EgoAlloBody:
    body = body_from_outputs([read_output(samples / NAME)], read_smplh_rest(samples / MODEL))
    assert body is not None
    return body


def test_shape(samples, reference_values):
    expected = reference_values["egoallo-shape"]["expect"]
    body = _body(samples)
    assert len(read_output(samples / NAME).world_from_root) == expected["samples"]
    assert body.joints.shape == (expected["frames"], expected["joints"], 3)
    assert [int(body.time_ns[0]), int(body.time_ns[-1])] == [expected["first_ns"], expected["last_ns"]]


def test_joints_of_the_first_frame_with_its_own_shape(samples, reference_values):
    item = reference_values["egoallo-joints-0"]
    output, rest = read_output(samples / NAME), read_smplh_rest(samples / MODEL)
    root = output.world_from_root[0, :1].astype(np.float64)
    rotations = np.concatenate([root[:, None, :4], output.body_quats[0, :1]], axis=1)
    joints, _ = pose_body(rest.of(output.betas[0, 0]), root[:, 4:], rotations)
    np.testing.assert_allclose(joints[0], item["expect"]["joints"], atol=1e-6)


def test_joints_with_the_mean_shape_keep_their_bones_and_stay_near(samples, reference_values):
    window = _body(samples)
    expected = np.array(reference_values["egoallo-joints-0"]["expect"]["joints"])
    assert np.linalg.norm(window.joints[0] - expected, axis=1).max() < 0.05  # only the shape differs
    bones = np.linalg.norm(np.diff(window.joints[:, [1, 4, 7, 10]], axis=1), axis=2)
    assert np.ptp(bones, axis=0).max() < 1e-5
