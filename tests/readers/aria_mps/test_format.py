from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prbench.readers.aria_mps.format import (
    combined_yaw,
    cpf_from_rgb,
    device_from_cpf,
    gaze_angles,
    gaze_directions_cpf,
    glasses_size,
)

ANGLES = st.floats(-1.2, 1.2)


def test_gaze_straight_ahead_left_and_up() -> None:
    directions = gaze_directions_cpf(np.array([0.0, np.pi / 4, 0.0]), np.array([0.0, 0.0, np.pi / 4]))
    expected = [(0, 0, 1), (np.sqrt(0.5), 0, np.sqrt(0.5)), (0, np.sqrt(0.5), np.sqrt(0.5))]
    assert directions == pytest.approx(np.array(expected))


@given(ANGLES, ANGLES)
def test_angles_are_the_inverse_of_directions(yaw, pitch) -> None:
    directions = gaze_directions_cpf(np.array([yaw]), np.array([pitch]))
    assert np.concatenate(gaze_angles(3.0 * directions)) == pytest.approx([yaw, pitch], abs=1e-9)


def test_tangents_not_angles_are_averaged_over_the_eyes() -> None:
    assert combined_yaw(np.array([0.5]), np.array([0.5])) == pytest.approx(0.5)
    assert combined_yaw(np.array([0.9]), np.array([0.1])) == pytest.approx(np.arctan((np.tan(0.9) + np.tan(0.1)) / 2))


@pytest.mark.parametrize("transform", [device_from_cpf("DVT-S"), device_from_cpf("DVT-L"), cpf_from_rgb()])
def test_transforms_are_rigid(transform) -> None:
    assert transform[:3, :3] @ transform[:3, :3].T == pytest.approx(np.eye(3), abs=1e-7)
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1.0)


def test_the_camera_sits_at_the_left_temple_and_looks_eight_degrees_down() -> None:
    axis = cpf_from_rgb()[:3, 2]
    assert np.rad2deg(np.arctan2(-axis[1], axis[2])) == pytest.approx(8.0)
    assert np.linalg.norm(cpf_from_rgb()[:3, 3]) == pytest.approx(0.0589, abs=5e-4)


def test_sizes_of_the_glasses() -> None:
    assert (glasses_size(0.1381), glasses_size(0.1427)) == ("DVT-S", "DVT-L")
    assert np.linalg.norm(device_from_cpf("DVT-S")[:3, 3]) == pytest.approx(0.0697, abs=5e-5)
    assert np.linalg.norm(device_from_cpf("DVT-L")[:3, 3]) == pytest.approx(0.0719, abs=5e-5)
