"""Schedules and samplers: by hand, beside diffusers and the published program."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from prbench_adapters.diffusion.generation import Guided
from prbench_adapters.diffusion.sampling import CosineSchedule, GeometricSchedule, sample_ddim, sample_ddpm
from tests.adapters.diffusion import golden, tiny

SHAPE = (2, 4, 3)


def _normal(seed: int = 0, shape: tuple[int, ...] = SHAPE) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def _any_denoiser(noisy: torch.Tensor, step: int) -> torch.Tensor:
    """A smooth function of state and step that is no optimal denoiser of anything."""
    return torch.tanh(noisy * (0.3 + 0.01 * step)) + 0.1


def _no_noise(step: int) -> torch.Tensor:
    return torch.zeros(SHAPE, dtype=torch.float64)


@pytest.mark.parametrize(("total", "steps"), [(50, 50), (50, 10), (1000, 20)])
@pytest.mark.parametrize("kind", ["ddim", "ddpm"])
def test_samplers_agree_with_the_schedulers_of_diffusers(kind, total, steps):
    module = pytest.importorskip(f"diffusers.schedulers.scheduling_{kind}")
    schedule, state, drawn = CosineSchedule(total), _normal(), [torch.Generator().manual_seed(7) for _ in range(2)]
    theirs = getattr(module, f"{kind.upper()}Scheduler")(
        num_train_timesteps=total, trained_betas=schedule.betas, prediction_type="sample", clip_sample=False
    )
    theirs.alphas_cumprod = torch.as_tensor(schedule.alphas_cumprod)  # theirs are rounded to float32
    theirs.one = theirs.final_alpha_cumprod = torch.tensor(1.0, dtype=torch.float64)
    theirs.set_timesteps(steps)
    expected = state
    for step in theirs.timesteps:
        clean = _any_denoiser(expected, int(step))
        expected = theirs.step(clean, int(step), expected, generator=drawn[0]).prev_sample
    if kind == "ddim":
        actual = sample_ddim(_any_denoiser, schedule, state, steps=steps)
    else:
        noise = lambda _: torch.randn(SHAPE, generator=drawn[1], dtype=torch.float64)  # noqa: E731
        actual = sample_ddpm(_any_denoiser, schedule, state, noise, steps=steps)
    torch.testing.assert_close(actual, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("steps", [10, 50])
def test_ddpm_on_unit_normal_data_without_noise_shrinks_by_the_last_signal_level(steps):
    """E[x_{t-1} | x_t] = √α_t x_t for x0 ~ N(0, 1); the product of all √α_t is √ᾱ of the start."""
    schedule = CosineSchedule(50)
    levels = schedule.alphas_cumprod

    def best(noisy: torch.Tensor, step: int) -> torch.Tensor:
        return noisy * math.sqrt(levels[step])

    expected = _normal() * math.sqrt(levels[schedule.kept_steps(steps)[-1]])
    torch.testing.assert_close(sample_ddpm(best, schedule, _normal(), _no_noise, steps=steps), expected)


def _chain(**kwargs: int) -> tuple[torch.Tensor, torch.Tensor]:
    model = tiny.model()
    start = torch.randn((2, 6, 263), generator=torch.Generator().manual_seed(2)).requires_grad_()
    batch = tiny.text_batch([6, 4])
    condition = model.encode(batch)
    n_frames = torch.tensor([6, 4])
    denoise = Guided(model.denoiser, condition, n_frames, 2.5, reuse=True)
    joints = model.joints(sample_ddim(denoise, model.schedule, start, **kwargs), condition, n_frames)
    (gradient,) = torch.autograd.grad(joints[0].square().sum() + joints[1, :4].square().sum(), start)
    return joints, gradient


@pytest.mark.parametrize("checkpointing", [1, 3, 8, 20])
def test_checkpointed_gradients_are_the_plain_ones(checkpointing):
    joints, gradient = _chain()
    joints_too, gradient_too = _chain(checkpointing=checkpointing)
    assert torch.equal(joints, joints_too)
    assert gradient.abs().max() > 0
    torch.testing.assert_close(gradient_too, gradient, rtol=1e-6, atol=1e-9)


def test_ddpm_asks_for_noise_in_every_step_but_the_last():
    asked = []

    def noise(step: int) -> torch.Tensor:
        asked.append(step)
        return _normal(step)

    sample_ddpm(_any_denoiser, CosineSchedule(50), _normal(), noise, steps=5)
    assert asked == [40, 30, 20, 10]


OURS = {
    "betas": "betas",
    "alphas_cumprod": "alphas_cumprod",
    "posterior_variance": "posterior_variance",
    "posterior_mean_coef1": "posterior_mean_clean",
    "posterior_mean_coef2": "posterior_mean_noisy",
}


def test_the_schedule_and_ten_steps_of_a_thousand_are_those_of_the_reference(samples):
    arrays = golden.load(samples, "diffusion_schedules")
    for n in (10, 50, 1000):
        for name, ours in OURS.items():
            np.testing.assert_allclose(getattr(CosineSchedule(n), ours), arrays[f"T{n}_{name}"], rtol=0, atol=1e-12)
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


def test_any_number_of_steps_can_be_kept_with_one_stride_from_zero_on():
    schedule = CosineSchedule(50)
    for n in range(1, 51):
        kept = schedule.kept_steps(n)
        assert (len(kept), kept[0]) == (n, 0)
        assert 50 - math.ceil(50 / n) <= kept[-1] < 50  # the last one is a stride from the end at most
        assert (np.diff(kept) > 0).all()
    assert schedule.kept_steps(25).tolist() == list(range(0, 50, 2))
    for n in (0, 51):
        with pytest.raises(ValueError, match="1 to 50"):
            schedule.kept_steps(n)


def test_one_step_of_a_schedule_by_hand():
    def level(s: float) -> float:
        return math.cos((s + 0.008) / 1.008 * math.pi / 2) ** 2

    assert CosineSchedule(2).betas == pytest.approx([1 - level(0.5) / level(0.0), 0.999])


def test_noise_over_motion_grows_by_the_same_factor_in_each_geometric_step():
    alphas = GeometricSchedule(16).alphas_cumprod
    ratio = np.sqrt((1 - alphas) / alphas)
    assert ratio[[0, -1]] == pytest.approx([0.05, 30.0])
    assert ratio[1:] / ratio[:-1] == pytest.approx(600 ** (1 / 15))


def test_geometric_steps_keep_more_of_the_spread_of_what_shows_in_many_frames_at_once():
    """Motions that differ by one number alone, their level: even the best denoiser loses its spread in cosine steps."""
    frames, count = 100, 400
    start = torch.randn((count, frames, 1), generator=torch.Generator().manual_seed(0))
    noise = torch.Generator().manual_seed(1)
    spreads = []
    for schedule in (GeometricSchedule(16), CosineSchedule(4)):
        alphas = torch.as_tensor(schedule.alphas_cumprod)

        def best(state, index, alphas=alphas):  # E[level | state] of a level of variance 1
            told = state.mean(dim=1, keepdim=True) / alphas[index].sqrt()
            return (told / (1 + (1 - alphas[index]) / alphas[index] / frames)).expand_as(state)

        draw = lambda _: torch.randn(start.shape, generator=noise)  # noqa: E731
        levels = sample_ddpm(best, schedule, start, draw)[:, 0]
        spreads.append(float(levels.std()))
    assert spreads[0] > 0.7
    assert spreads[1] < 0.5


@pytest.mark.parametrize(
    ("n", "indices"), [(1, [49]), (4, [11, 24, 36, 49]), (5, [9, 19, 29, 39, 49]), (50, list(range(50)))]
)
def test_trailing_steps_end_at_the_noisiest(n, indices):
    schedule = CosineSchedule(50)
    assert schedule.kept_steps(n, "trailing").tolist() == indices
    chain = schedule.chain(n, "trailing")
    assert chain.alphas_cumprod[-1] == schedule.alphas_cumprod[-1]
    assert chain.alphas_cumprod_previous[0] == 1.0
