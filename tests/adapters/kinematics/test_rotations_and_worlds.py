"""Six numbers of a rotation, and worlds with Z up."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from prbench.axes import z_up
from prbench.skeleton import Joint
from prbench_adapters.kinematics.rotations import matrices_of, orthonormalised, rows_of
from prbench_adapters.kinematics.skeleton import root_orientation
from prbench_adapters.kinematics.worlds import DART, WANDR
from tests.fakes import STANDING

STANDING_POSE = torch.tensor(STANDING)
RANDOM = torch.tensor(Rotation.random(9, rng=np.random.default_rng(1)).as_matrix())


def test_six_numbers_are_the_first_two_rows():
    quarter = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # about z
    assert rows_of(quarter).tolist() == [0, -1, 0, 1, 0, 0]
    assert torch.allclose(matrices_of(rows_of(RANDOM)), RANDOM)


def test_any_six_numbers_become_a_rotation_that_keeps_the_direction_of_the_first_row():
    made = matrices_of(torch.tensor([[0.0, 2.0, 0.0, 3.0, 5.0, 0.0]]))
    assert made.tolist() == [[[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]]
    scaled = orthonormalised(RANDOM * 1.01)
    assert torch.allclose(scaled, RANDOM)


def test_worlds_turn_without_mirroring_and_back():
    points = torch.randn(7, 3, generator=torch.Generator().manual_seed(0))
    for world in (DART, WANDR):
        matrix = world.from_y_up(torch.eye(3)).T
        assert torch.allclose(torch.linalg.det(matrix), torch.tensor(1.0))
        assert torch.equal(world.to_y_up(world.from_y_up(points)), points)


def test_where_a_standing_body_faces():
    front, left = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    assert DART.from_y_up(front).tolist() == [0, 1, 0]
    assert (-DART.from_y_up(left)).tolist() == [1, 0, 0]  # its right side
    assert WANDR.from_y_up(front).tolist() == [0, -1, 0]
    assert WANDR.from_y_up(left).tolist() == [1, 0, 0]
    assert np.array_equal(WANDR.from_y_up(STANDING_POSE), z_up(STANDING))
    assert torch.equal(DART.to_y_up(DART.from_y_up(STANDING_POSE)), STANDING_POSE)


def test_fit_in_another_world_is_the_fit_turned():
    turned = root_orientation(WANDR.from_y_up(STANDING_POSE))
    assert torch.allclose(turned[:, 2], WANDR.from_y_up(root_orientation(STANDING_POSE)[:, 2]))
    assert STANDING_POSE[Joint.HEAD, 1] > 1
