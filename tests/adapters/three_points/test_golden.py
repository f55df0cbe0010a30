"""The public program's values for AvatarPoser; sizes come from the file, and so do parents and weights."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench_adapters.three_points import features
from prbench_adapters.three_points.regressor import Regressor, RegressorConfiguration


@pytest.fixture(scope="module")
def golden(samples):
    with np.load(samples / "nymeria-tasks" / "avatarposer.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


@pytest.fixture(scope="module")
def network(golden):
    """The public network: its parameters keep their names."""
    weights = {name.removeprefix("w/"): each.float() for name, each in golden.items() if name.startswith("w/")}
    hidden, width = weights["stabilizer.0.weight"].shape
    sizes = {"heads": int(golden["heads"]), "window": int(golden["window"]), "time": "none"}
    sizes["layers"] = sum(name.endswith("linear1.weight") for name in weights)
    sizes["feed_forward"] = len(weights["transformer_encoder.layers.0.linear1.weight"])
    network = Regressor(RegressorConfiguration(width=width, hidden=hidden, **sizes))
    network.load_state_dict(weights)
    return network.eval().requires_grad_(False)


def matrices(axis_angle):
    return torch.from_numpy(Rotation.from_rotvec(axis_angle.reshape(-1, 3).double()).as_matrix())


def raw(columns):
    """Two columns and their cross product, as the public program takes them: mostly no rotation."""
    first, second = columns.double().unflatten(-1, (2, 3)).unbind(-2)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def published_axis_angle(columns):
    """Axis and angle of the quaternion of the raw matrix, whatever its length, by the program's four branches."""
    found = []
    for m in raw(columns).reshape(-1, 3, 3).numpy():
        branch = 3 - int(m[0, 0] < -m[1, 1])
        if m[2, 2] < 1e-6:
            branch = int(m[0, 0] <= m[1, 1])
        signs = np.array([[1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1]])[branch]
        total = 1 + signs @ np.diag(m)
        differences = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
        if branch == 3:
            quaternion = np.array([total, *differences])
        else:
            vector = m[branch] + m[:, branch]
            vector[branch] = total
            quaternion = np.array([differences[branch], *vector])
        w, vector = quaternion[0], quaternion[1:]
        sine = np.linalg.norm(vector)
        angle = 2 * np.arctan2(-sine, -w) if w < 0 else 2 * np.arctan2(sine, w)
        found.append(vector * angle / sine)
    return torch.from_numpy(np.array(found)).reshape(*columns.shape[:-1], 3)


def published_joints(axis_angle, golden):
    """All joints of the program's skeleton, fingers unbent, with the root where it rests."""
    rest, parents = golden["rest"].double(), golden["parents"].tolist()
    local = torch.eye(3, dtype=torch.float64).repeat(len(axis_angle), len(parents), 1, 1)
    body = axis_angle.reshape(len(axis_angle), -1, 3)
    local[:, : body.shape[1]] = matrices(body).reshape(*body.shape, 3)
    return features.kinematic_joints(local, rest - rest[[max(parent, 0) for parent in parents]], parents) + rest[0]


def close(found, expected, tolerance):
    np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=0, atol=tolerance)


def test_features(golden):
    close(features.frame_values(golden["device_position"], golden["device_rotation"]), golden["features"], 3e-5)
    target = features.columns_of(matrices(golden["poses"])).reshape(len(golden["poses"]), -1)
    close(target[1:], golden["target6d"], 3e-5)


def test_six_numbers_as_rotations(golden):
    close(raw(golden["sixd"]), golden["sixd_matrix_raw"], 1e-6)
    close(published_axis_angle(golden["sixd"]), golden["sixd_axis_angle"], 1e-6)
    close(features.matrices_of_columns(golden["sixd"]), golden["sixd_gram_schmidt"], 1e-6)


def test_network_on_windows(golden, network):
    rows = golden["features"]
    windows = torch.stack([rows[start : start + network.configuration.window] for start in golden["window_starts"]])
    found = network(windows)
    close(found[:, :6], golden["window_root6d"], 1e-6)
    close(found[:, 6:], golden["window_joint6d"], 1e-6)
    joints = published_joints(published_axis_angle(found.unflatten(1, (-1, 6))), golden)
    close(joints, golden["window_positions"], 8e-6)


def test_training_loss(golden, network):
    start, window = int(golden["train_start"]), network.configuration.window
    found = network(golden["features"][None, start : start + window + 1])  # one row more than at test
    close(torch.cat([golden["train_root6d"], golden["train_joint6d"]], dim=1), found, 5e-6)
    target = golden["target6d"][None, start + window - 1]
    close(target, golden["train_target6d"], 5e-6)
    joints = [published_joints(published_axis_angle(each.unflatten(1, (-1, 6))), golden) for each in (found, target)]
    close(joints[0], golden["train_positions"], 5e-6)
    close(joints[1], golden["train_target_positions"], 5e-6)
    parts = network.loss_parts([each.unflatten(1, (-1, 6)) for each in (found, target)], joints)
    close([parts[name] for name in ("root", "rotations", "positions")], golden["loss_parts"], 5e-6)
    close(parts["loss"], golden["loss"], 5e-6)


def test_sequence_begins_with_a_growing_prefix(golden, network):
    rows, window = golden["features"][1:], network.configuration.window
    found = torch.cat([network(rows[None, max(end - window, 0) : end]) for end in range(1, len(rows) + 1)])
    axis_angle = published_axis_angle(found.unflatten(1, (-1, 6)))
    close(axis_angle.flatten(1), golden["sequence_axis_angle"], 8e-6)
    joints = published_joints(axis_angle, golden)[:, :22]
    root = golden["device_position"][2:, 0].double() - joints[:, 15]
    close(root, golden["sequence_translation"], 8e-6)
    close(joints + root[:, None], golden["sequence_positions"], 8e-6)
    recorded = published_joints(golden["poses"], golden)[2:, :22] + golden["trans"][2:, None].double()
    close(recorded, golden["sequence_true_positions"], 8e-6)
