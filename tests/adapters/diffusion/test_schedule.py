from __future__ import annotations

import math

import numpy as np
import pytest

from prbench_adapters.diffusion.schedule import CosineSchedule
from tests.adapters.diffusion import golden

OURS = {
    "betas": "betas",
    "alphas_cumprod": "alphas_cumprod",
    "posterior_variance": "posterior_variance",
    "posterior_mean_coef1": "posterior_mean_clean",
    "posterior_mean_coef2": "posterior_mean_noisy",
}


@pytest.mark.parametrize("n_steps", [10, 50, 1000])
@pytest.mark.parametrize("name", OURS)
def test_the_schedule_is_that_of_the_reference(samples, n_steps, name):
    expected = golden.load(samples, "diffusion_schedules")[f"T{n_steps}_{name}"]
    np.testing.assert_allclose(getattr(CosineSchedule(n_steps), OURS[name]), expected, rtol=0, atol=1e-12)


def test_ten_steps_of_a_thousand_are_those_of_the_reference(samples):
    arrays = golden.load(samples, "diffusion_schedules")
    chain = CosineSchedule(1000).chain(10)
    np.testing.assert_array_equal(chain.indices, arrays["ddim10_of_1000_indices"])
    np.testing.assert_allclose(chain.alphas_cumprod, arrays["ddim10_of_1000_alphas_cumprod"], rtol=0, atol=1e-12)


def test_the_numbers_that_the_page_prints():
    schedule = CosineSchedule(50)
    assert schedule.betas[[0, 25, 49]] == pytest.approx([0.0017475135, 0.0630497774, 0.999], abs=1e-10)
    assert schedule.alphas_cumprod[[25, 49]] == pytest.approx([0.4627068620, 9.7119303e-7], rel=1e-7)
    assert schedule.posterior_mean_clean[25] == pytest.approx(0.0824644893, abs=1e-10)
    assert schedule.posterior_mean_noisy[25] == pytest.approx(0.9118674347, abs=1e-10)
    assert schedule.posterior_variance[1] == pytest.approx(0.0011871957, abs=1e-10)


@pytest.mark.parametrize(
    ("n", "first", "last"), [(50, (0, 1), 49), (25, (0, 2), 48), (10, (0, 5), 45), (5, (0, 10), 40)]
)
def test_kept_steps_have_one_stride_and_begin_at_zero(n, first, last):
    kept = CosineSchedule(50).kept_steps(n)
    assert len(kept) == n
    assert tuple(kept[:2]) == first
    assert kept[-1] == last


def test_any_number_of_steps_can_be_kept():
    schedule = CosineSchedule(50)
    for n in range(1, 51):
        kept = schedule.kept_steps(n)
        assert len(kept) == n
        assert kept[0] == 0
        assert 50 - math.ceil(50 / n) <= kept[-1] < 50  # the last one is a stride from the end at most
        assert (np.diff(kept) > 0).all()


@pytest.mark.parametrize("n", [0, 51])
def test_more_steps_than_there_are_cannot_be_kept(n):
    with pytest.raises(ValueError, match="1 to 50"):
        CosineSchedule(50).kept_steps(n)


def test_a_shorter_chain_has_the_betas_that_lead_to_its_own_noise_levels():
    chain = CosineSchedule(50).chain(10)
    assert np.cumprod(1 - chain.betas) == pytest.approx(chain.alphas_cumprod, rel=1e-12)


def test_the_posterior_factors_keep_the_variance_of_unit_normal_data():
    """x0 ~ N(0, 1) makes every x_t ~ N(0, 1): E[x_{t-1} | x_t] is √α_t x_t, whatever the schedule."""
    for chain in (CosineSchedule(50), CosineSchedule(1000).chain(7)):
        mean = chain.posterior_mean_clean * np.sqrt(chain.alphas_cumprod) + chain.posterior_mean_noisy
        assert mean == pytest.approx(np.sqrt(1 - chain.betas), rel=1e-12)


def test_one_step_of_a_schedule_by_hand():
    def level(s: float) -> float:
        return math.cos((s + 0.008) / 1.008 * math.pi / 2) ** 2

    assert CosineSchedule(2).betas == pytest.approx([1 - level(0.5) / level(0.0), 0.999])


@pytest.mark.parametrize(
    ("n", "indices"), [(1, [49]), (4, [11, 24, 36, 49]), (5, [9, 19, 29, 39, 49]), (50, list(range(50)))]
)
def test_trailing_steps_end_at_the_noisiest(n, indices):
    schedule = CosineSchedule(50)
    assert schedule.kept_steps(n, "trailing").tolist() == indices
    chain = schedule.chain(n, "trailing")
    assert chain.alphas_cumprod[-1] == schedule.alphas_cumprod[-1]
    assert chain.alphas_cumprod_previous[0] == 1.0
