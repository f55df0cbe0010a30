"""Chains from noise to joints, and batches whose noise is optimised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from prbench_adapters.diffusion.generation import Guided, start_noise
from prbench_adapters.diffusion.noise_optimisation import OptimisationSettings, Targets
from prbench_adapters.diffusion.optimised_generation import UnrolledChain, optimise_noise
from prbench_adapters.diffusion.sampling import sample_ddim
from tests.adapters.diffusion import tiny

SETTINGS = OptimisationSettings(ddim_steps=4)
LENGTHS = torch.tensor([9, 6])


def _chain(settings=SETTINGS, model=None, **changes):
    model = tiny.model(**changes) if model is None else model
    return UnrolledChain(model, model.encode(tiny.text_batch(LENGTHS.tolist())), LENGTHS, settings)


def _noise(dtype=torch.float32):
    return torch.randn(2, 9, 263, generator=torch.Generator().manual_seed(0), dtype=dtype)


def _gradient(chain, noise):
    noise = noise.clone().requires_grad_()
    weights = torch.linspace(0.5, 1.5, 66, dtype=noise.dtype).reshape(22, 3)
    joints = chain(noise)
    valid = torch.arange(9) < LENGTHS[:, None]
    (gradient,) = torch.autograd.grad((joints * weights * valid[..., None, None]).square().sum(), noise)
    return gradient


@pytest.mark.parametrize("guidance", [1.0, 2.5])
def test_the_chain_is_that_of_plain_sampling(guidance):
    model = tiny.model()
    condition = model.encode(tiny.text_batch(LENGTHS.tolist()))
    plain = sample_ddim(Guided(model.denoiser, condition, LENGTHS, guidance), model.schedule, _noise(), steps=4)
    chain = _chain(replace(SETTINGS, guidance=guidance), model)
    torch.testing.assert_close(chain(_noise()), model.joints(plain, condition, LENGTHS))
    assert chain.network_passes == (4 if guidance == 1.0 else 8)


@pytest.mark.parametrize("architecture", ["decoder", "encoder"])
def test_gradients_with_respect_to_noise_agree_with_finite_differences(architecture):
    model = tiny.model(architecture=architecture)
    model.denoiser.double()
    model.mean, model.std = model.mean.double(), model.std.double()
    condition = model.encode(tiny.text_batch(LENGTHS.tolist()))
    condition = replace(condition, text=condition.text.double())
    chain = UnrolledChain(model, condition, LENGTHS, SETTINGS)
    noise, valid = _noise(torch.float64), (torch.arange(9) < LENGTHS[:, None])[..., None, None]

    def total(start):
        return (chain(start) * valid).square().sum().item()

    gradient_at = noise.clone().requires_grad_()
    (gradient,) = torch.autograd.grad((chain(gradient_at) * valid).square().sum(), gradient_at)
    for row, frame, feature in ((0, 0, 0), (0, 3, 2), (1, 5, 3), (1, 2, 40), (0, 8, 200)):
        step = torch.zeros_like(noise)
        step[row, frame, feature] = 1e-5
        slope = (total(noise + step) - total(noise - step)) / 2e-5
        assert gradient[row, frame, feature].item() == pytest.approx(slope, rel=1e-5, abs=1e-9)
    assert gradient[1, 6:].abs().max() == 0.0, "padding has no influence"


@pytest.mark.parametrize("block", [1, 3])
def test_recomputed_activations_give_the_same_gradients_at_the_price_of_counted_passes(block):
    plain, recomputing = _chain(), _chain(replace(SETTINGS, checkpointing=block))
    torch.testing.assert_close(_gradient(recomputing, _noise()), _gradient(plain, _noise()), rtol=0, atol=0)
    assert (plain.network_passes, recomputing.network_passes) == (4, 8)


def test_some_rows_of_a_chain_give_those_rows():
    chain = _chain()
    whole = chain(_noise())
    part = chain.rows(torch.tensor([1]))
    torch.testing.assert_close(part(_noise()[1:]), whole[1:])
    assert chain.network_passes == part.network_passes == 8


QUICK = OptimisationSettings(ddim_steps=2, iterations=4, warmup=1, decorrelation_weight=100.0, batch_size=2)
FRAMES, SEEDS = [30, 9, 12, 31], [7, 3, 5, 2]


def _solve(rows):
    model = tiny.model()
    n_frames = [FRAMES[row] for row in rows]
    seeds = tuple(SEEDS[row] for row in rows)
    locations = torch.tensor([[0.1 * row, 1.0, 0.2] for row in rows])
    initial = torch.zeros(len(rows), 22, 3)
    return optimise_noise(
        model,
        model.encode(tiny.text_batch(n_frames), texts=tuple(tiny.TEXTS[row % 2] for row in rows)),
        Targets(initial_joints=initial, goal_location=locations),
        torch.tensor(n_frames),
        start_noise(seeds, np.array(n_frames)),
        QUICK,
        seeds=seeds,
    )


def test_every_sequence_gets_what_it_would_get_alone_in_the_order_given():
    together = _solve([0, 1, 2, 3])
    for row, length in enumerate(FRAMES):
        alone = _solve([row])
        torch.testing.assert_close(together.joints[row, :length], alone.joints[0], rtol=0, atol=1e-4)
        torch.testing.assert_close(together.noise[row, :length], alone.noise[0], rtol=0, atol=1e-3)
        np.testing.assert_allclose(together.goal[row], alone.goal[0], rtol=1e-3)
    assert together.network_passes.tolist() == [2 * 5] * 4
