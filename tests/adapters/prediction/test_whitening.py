from __future__ import annotations

import pytest
import torch

from prbench_adapters.prediction.coefficient_diffusion import CoefficientDiffusion, Whitening
from prbench_adapters.prediction.configuration import preset


@pytest.fixture
def coefficients() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    mixed = torch.randn((500, 4, 9), generator=generator) @ torch.randn((9, 9), generator=generator)
    return mixed * torch.tensor([4.0, 2.0, 1.0, 0.5])[:, None]


def test_whitened_numbers_have_unit_spread_and_go_back_to_metres(coefficients):
    whitening = Whitening(4, 9)
    whitening.take(coefficients)
    whitened = whitening(coefficients)
    torch.testing.assert_close(whitened.square().mean(dim=0), torch.ones(4, 9))
    assert (whitened.flatten(0, 1).T @ whitened.flatten(0, 1) / 2000 - torch.eye(9)).abs().max() < 0.1  # by chance 0.07
    torch.testing.assert_close(whitening.inverse(whitened), coefficients, atol=1e-4, rtol=1e-4)


def test_directions_in_half_precision_are_still_undone_exactly(coefficients):
    whitening = Whitening(4, 9)
    whitening.take(coefficients)
    whitening.directions.copy_(whitening.directions.half())
    whitening.spread.copy_(whitening.spread.half())
    torch.testing.assert_close(whitening.inverse(whitening(coefficients)), coefficients, atol=1e-4, rtol=1e-4)


def test_a_direction_without_spread_is_not_divided_by_zero():
    whitening = Whitening(2, 3)
    whitening.take(torch.zeros(5, 2, 3))
    assert whitening(torch.zeros(1, 2, 3)).isfinite().all()


def test_observed_frames_are_put_back_in_metres(coefficients):
    """Whatever the network answers, the observed frames end up where they were."""
    shape = preset(
        "humanmac", n_joints=3, observed=6, predicted=4, coefficients=10, width=8, heads=2, layers=2, feed_forward=8,
        diffusion_steps=20, sampling_steps=10, predicts="velocity", residual=True, whitened=True,
    )  # fmt: skip
    model = CoefficientDiffusion(shape).eval()
    assert model.whitening is not None
    generator = torch.Generator().manual_seed(1)
    model.whitening.take(torch.randn((50, 10, 9), generator=generator) @ torch.randn((9, 9), generator=generator))
    known = torch.zeros(1, 10, 9)
    noise = torch.randn((1, 2, 10, 9), generator=generator)
    *_, state = model.states(known, torch.zeros(1, 10, 9), lambda: noise)
    residual = model.transform.inverse(model.whitening.inverse(state))[:, :, :6]
    level = float(model.schedule.alphas_cumprod[0])
    expected = model.transform.inverse(model.whitening.inverse((1.0 - level) ** 0.5 * noise))[:, :, :6]
    torch.testing.assert_close(residual, expected, atol=1e-4, rtol=1e-4)


def test_whitening_needs_residuals():
    with pytest.raises(ValueError, match="'whitened' needs 'residual' true"):
        preset("humanmac", n_joints=3, whitened=True)
