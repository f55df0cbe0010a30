"""Errors of bodies: the case worked by hand, the published programs' numbers, and what must leave no trace."""

from __future__ import annotations

import numpy as np
import pytest

from prbench_benchmarks.three_points.metrics import METRICS, tracking_errors

COLUMNS = {
    "MPJPE cm": "mpjpe",
    "MPJVE cm/s": "mpjve",
    "hands cm": "mpjpe_hands",
    "upper cm": "mpjpe_upper",
    "lower cm": "mpjpe_lower",
    "pelvis cm": "mpjpe_pelvis",
}


@pytest.fixture
def golden(samples):
    path = samples / "nymeria-tasks" / "tracking_metrics.npz"
    if not path.is_file():
        pytest.skip("the samples hold no golden values of tracking")
    return np.load(path)


def pairs(golden):
    """The sequences of a golden file as one padded batch."""
    predicted = [golden[f"pred_{row}"] for row in range(len(golden["bodiffusion"]))]
    recorded = [golden[f"gt_{row}"] for row in range(len(predicted))]
    n_frames = np.array([len(each) for each in recorded])
    padded = np.full((2, len(n_frames), n_frames.max(), 22, 3), np.nan)
    for row, n in enumerate(n_frames):
        padded[:, row, :n] = predicted[row], recorded[row]
    return *padded, n_frames


@pytest.mark.parametrize("program", ["avatarposer", "bodiffusion"])
def test_the_published_programs_numbers_and_their_mean_over_sequences(golden, program):
    found = tracking_errors(*pairs(golden), 60.0)
    for place, name in enumerate(golden[f"columns_{program}"]):
        assert found[COLUMNS[str(name)]] == pytest.approx(golden[program][:, place], abs=1e-4)
        assert found[COLUMNS[str(name)]].mean() == pytest.approx(golden[f"{program}_mean"][place], abs=1e-4)


def test_two_joints_worked_by_hand():
    recorded = np.zeros((1, 4, 22, 3))
    predicted = recorded.copy()
    predicted[0, :3, 20, 0] = 0.01, 0.03, 0.03
    predicted[0, :3, 21, 1] = 0.02
    predicted[0, 3] = np.nan
    three = np.array([3])
    # The other 20 joints are right, so that 2 of 22 carry the errors.
    with np.errstate(invalid="ignore"):
        found = tracking_errors(predicted, recorded, three + 0, 60.0)
    assert found["mpjpe_hands"][0] == pytest.approx(13 / 6)
    assert found["mpjpe"][0] == pytest.approx(13 / 6 * 2 / 22)
    assert found["mpjve"][0] == pytest.approx(30.0 * 2 / 22)
    assert found["mpjpe_lower"][0] == 0.0


def test_jitter_is_the_third_difference_at_the_rate():
    cubed = np.zeros((1, 6, 22, 3))
    cubed[0, :, :, 1] = (np.arange(6)[:, None] ** 3) * 1e-3
    found = tracking_errors(np.zeros_like(cubed), cubed, np.array([6]), 20.0)
    assert found["jitter_recorded"][0] == pytest.approx(48.0)
    assert found["jitter"][0] == 0.0


def test_padding_and_the_rest_of_the_batch_leave_no_trace():
    rng = np.random.default_rng(3)
    predicted, recorded = rng.normal(size=(2, 3, 8, 22, 3))
    n_frames = np.array([8, 5, 4])
    whole = tracking_errors(predicted, recorded, n_frames, 30.0)
    predicted[1, 5:] = np.nan
    alone = tracking_errors(predicted[1:2], recorded[1:2], n_frames[1:2], 30.0)
    assert set(whole) == {info.id for info in METRICS}
    for name, values in whole.items():
        assert alone[name][0] == pytest.approx(values[1], rel=1e-12)
