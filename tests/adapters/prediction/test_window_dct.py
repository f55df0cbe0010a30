"""The check values of docs/specification/gazemodiff.md#check-values, and what completion keeps."""

from __future__ import annotations

import math

import pytest
import torch

from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.prediction.coefficient_diffusion import WindowDCT, dct_rows, held, padded


def test_rows_of_constant_and_rising_values():
    rows = dct_rows(4, 75)
    assert (rows @ torch.ones(75).double()).tolist() == pytest.approx([8.660254, 0, 0, 0], abs=1e-6)
    rising = rows @ torch.arange(75).double()
    assert rising.tolist() == pytest.approx([320.429399, -186.125290, 0, -20.668473], abs=1e-6)


@pytest.mark.parametrize(("hertz", "share"), [(0.5, 0.9995), (1.0, 0.9934), (2.0, 0.7442), (2.5, 0.2233)])
def test_ten_coefficients_keep_slow_movements_only(hertz, share):
    wave = torch.sin(2 * math.pi * hertz * torch.arange(75).double() / 30)
    assert float((dct_rows(10, 75) @ wave).norm() / wave.norm()) == pytest.approx(share, abs=1e-4)


def test_a_walking_body_is_off_by_centimetres_after_truncation():
    transform = WindowDCT(10, 15, 75)
    walk = torch.zeros(1, 75, 1, 3).double()
    walk[0, :, 0, 0] = 1.4 / 30 * torch.arange(75)
    error = (transform.inverse(transform(walk)) - walk).norm(dim=-1)[0, :, 0]
    assert float(error[15:].mean()) == pytest.approx(0.0074, abs=1e-4)
    assert float(error[-1]) == pytest.approx(0.0494, abs=1e-4)
    frozen = padded(walk[:, :15], 75)
    assert float((transform.inverse(transform(frozen)) - frozen)[0, 14, 0, 0].abs()) == pytest.approx(0.031, abs=1e-3)


def test_completion_equals_the_exchange_of_frames():
    transform = WindowDCT(10, 15, 75)
    own, known = torch.randn(3, 2, 10, 6).double(), torch.randn(3, 1, 10, 6).double()
    frames = transform.inverse(own).clone()
    frames[:, :, :15] = transform.inverse(known)[:, :, :15]
    torch.testing.assert_close(transform.completed(own, known), transform(frames))


def test_padding_repeats_the_last_frame_and_the_last_measured_gaze():
    observed = torch.arange(4.0).view(1, 4, 1, 1).expand(1, 4, 2, 3)
    filled = padded(held(observed, torch.tensor([[False, True, False, False]])), 6)
    assert filled[0, :, 0, 0].tolist() == [0, 1, 2, 3, 3, 3]
    assert filled[0, :, 1, 0].tolist() == [1] * 6
    with pytest.raises(ValueError, match="4 frames does not fit into a window of 3"):
        padded(observed, 3)


def test_schedule_of_1500_steps():
    schedule = CosineSchedule(1500)
    for index, value in ((0, 2.698328e-5), (750, 2.103810e-3), (1499, 0.999)):
        assert schedule.betas[index] == pytest.approx(value, rel=1e-6)
    for index, value in ((0, 0.9999730167), (1, 0.9999438753), (16, 0.9992478880), (751, 0.4917657159)):
        assert schedule.alphas_cumprod[index] == pytest.approx(value, abs=1e-10)
    assert schedule.alphas_cumprod[1486] == pytest.approx(1.824164e-4, rel=1e-6)
