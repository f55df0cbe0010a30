"""Rotations in NumPy, against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import rotation_matrices
from prbench.representation.converters.smpl import from_axis_angle, from_matrices

RNG = np.random.default_rng(0)
VECTORS = np.concatenate(
    [RNG.normal(size=(200, 3)), 1e-9 * RNG.normal(size=(5, 3)), np.zeros((1, 3)), np.pi * np.eye(3), -np.pi * np.eye(3)]
)


def test_axis_angles_become_the_quaternions_of_scipy() -> None:
    expected = Rotation.from_rotvec(VECTORS).as_quat(scalar_first=True)
    assert np.allclose(from_axis_angle(VECTORS), expected, rtol=0, atol=1e-15)


def test_matrices_there_and_back_lose_nothing_at_half_turns_either() -> None:
    matrices = Rotation.from_rotvec(VECTORS).as_matrix()
    assert np.allclose(rotation_matrices(from_matrices(matrices)), matrices, rtol=0, atol=1e-14)
    assert np.allclose(rotation_matrices(from_axis_angle(VECTORS)), matrices, rtol=0, atol=1e-14)


@pytest.mark.parametrize("shape", [(30,), (6, 5)])
def test_any_leading_axes_will_do(shape) -> None:
    vectors = RNG.normal(size=(*shape, 3))
    matrices = rotation_matrices(from_axis_angle(vectors))
    assert matrices.shape == (*shape, 3, 3)
    assert from_matrices(matrices).shape == (*shape, 4)
