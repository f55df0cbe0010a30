"""X from relative motions: values worked by hand, the published program's, and the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.alignment.hand_eye import (
    Motions,
    motions_between,
    rotation_of,
    translation_of,
)


def closed_form(device: np.ndarray, segment: np.ndarray, *, stride: int = 2) -> np.ndarray:
    """X from all motions over ``stride`` frames, without weights or gates, as the published program does."""
    first = np.arange(len(device) - stride)
    poses = [(Rotation.from_matrix(each[:, :, :3]), each[:, :, 3]) for each in (device, segment)]
    found = motions_between((first, first + stride), np.arange(len(device), dtype=float), *poses)
    x = np.eye(4)
    x[:3, :3], _ = rotation_of(found)
    x[:3, 3], _ = translation_of(found, x[:3, :3])
    return x


@pytest.fixture
def golden(samples):
    path = samples / "nymeria-tasks" / "hand_eye.npz"
    if not path.is_file():
        pytest.skip("the samples hold no golden values of the hand-eye solver")
    return np.load(path)


@pytest.mark.parametrize("stride", [1, 2, 24])
def test_the_published_program_s_x_is_reproduced(golden, stride):
    found = closed_form(golden["A"], golden["B"], stride=stride)
    assert np.abs(found - golden[f"X_stride{stride}"]).max() < 1e-12


def closed_form_windows(device: np.ndarray, segment: np.ndarray, *, window: int, skip: int) -> np.ndarray:
    """The published program's windows around the poses 0, skip, …; those at the end lack the last pose."""
    estimates = []
    for centre in range(0, len(device), skip):
        start = max(centre - window // 2, 0)
        start, stop = (start, start + window) if start + window < len(device) else (len(device) - window, -1)
        estimates.append(closed_form(device[start:stop], segment[start:stop], stride=2))
    return np.stack(estimates)


def test_the_published_program_s_windows_are_reproduced_and_the_same_ones_used(golden):
    window, skip = int(golden["window"]), int(golden["skip"])
    found = closed_form_windows(golden["A"], golden["B"], window=window, skip=skip)
    assert found.shape == golden["X_windows"].shape
    assert np.abs(found - golden["X_windows"]).max() < 1e-12
    # It uses the first window whose centre is not before the time.
    centres = np.arange(len(found)) * skip / 240
    used = np.minimum(np.searchsorted(centres, golden["query_ns"] / 1e9), len(found) - 1)
    assert used.tolist() == golden["query_window"].tolist()


def test_noise_free_motions_and_two_axes_give_the_truth(golden):
    assert np.abs(closed_form(golden["A_clean"], golden["B_clean"]) - golden["X_clean"]).max() < 1e-12
    found = closed_form(golden["A_two_axes"], golden["B_two_axes"], stride=1)
    assert np.abs(found - golden["X_two_axes_true"]).max() < 1e-12


def motions(turns, moves, x) -> Motions:
    """Motions of a segment, and those of a device that sits on it by X."""
    turns, moves = np.array(turns), np.array(moves)
    turn_a = turns @ x[:3, :3].T
    matrix = Rotation.from_rotvec(turn_a).as_matrix()
    move_a = moves @ x[:3, :3].T + x[:3, 3] - matrix @ x[:3, 3]
    return Motions(np.arange(len(turns), dtype=float), turn_a, move_a, turns, moves, matrix)


X = np.array([[0, -1, 0, 0.10], [1, 0, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1.0]])


def test_the_worked_case():
    # By hand: X turns by 90 degrees about z; the two motions turn by 30 degrees about x and about y.
    worked = motions([(0.523599, 0, 0), (0, 0.523599, 0)], [(0.1, 0, 0), (0, 0.2, 0)], X)
    assert np.allclose(worked.turn_a, [(0, 0.523599, 0), (-0.523599, 0, 0)])
    assert np.allclose(worked.move_a, [(-0.011603, 0.1, 0.056699), (-0.2, -0.025, 0.006699)], atol=1e-6)
    rotation, singular = rotation_of(worked)
    translation, _ = translation_of(worked, rotation)
    assert np.abs(rotation - X[:3, :3]).max() < 1e-12
    assert np.abs(translation - X[:3, 3]).max() < 1e-12
    assert singular == pytest.approx([0.274156, 0.274156, 0.0], abs=1e-6)


def test_one_axis_is_told_by_the_second_singular_value():
    turns = np.deg2rad([(0, 0, 5), (0, 0, 10), (0, 0, 20), (0, 0, -15)])
    _, singular = rotation_of(motions(turns, np.zeros((4, 3)), X))
    assert singular[0] > 0.1
    assert singular[1] < 1e-12
