"""The published solver's course on a tiny network, iteration by iteration (samples/metrics/PROVENANCE.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from prbench.representation import tensors
from prbench_adapters.diffusion.configuration import EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.noise_optimisation import (
    OptimisationSettings,
    Targets,
    decorrelation,
    keyframes,
    learning_rate_factor,
)
from prbench_adapters.diffusion.optimised_generation import optimise_noise
from tests.adapters.diffusion import golden

PUBLISHED = OptimisationSettings(
    ddim_steps=10, iterations=60, learning_rate=0.05, warmup=50, decorrelation_weight=1000.0, guidance=2.5
)


@dataclass
class GoldenModel:
    denoiser: Denoiser
    mean: torch.Tensor
    std: torch.Tensor

    def joints(self, normalised, condition, n_frames):
        return tensors.decode(normalised * self.std + self.mean)


@pytest.fixture(scope="module")
def arrays(samples):
    return golden.load(samples, "dno_optimisation")


@pytest.fixture(scope="module")
def solved(arrays):
    """The whole run, 60 iterations."""
    trace = Trace()
    trace.found = _solve(arrays, PUBLISHED, trace)
    return trace


class Trace:
    """Noise, losses and other numbers of every iteration."""

    def __init__(self):
        self.noises, self.losses, self.numbers = [], [], []

    def __call__(self, noise, losses, numbers):
        self.noises.append(noise)
        self.losses.append(losses)
        self.numbers.append(numbers)


def _solve(arrays, settings, watch):
    network = golden.denoiser(arrays, diffusion_steps=1000)
    model = GoldenModel(network, torch.from_numpy(arrays["mean"]), torch.from_numpy(arrays["std"]))
    noise, target = golden.features(arrays["z0"]), torch.from_numpy(arrays["target"])
    text = torch.from_numpy(arrays["text"]).expand(len(noise), 1, -1)
    condition = EncodedCondition(text, torch.zeros(text.shape[:2], dtype=torch.bool))
    return optimise_noise(
        model,
        condition,
        Targets(
            initial_joints=target[:, 0],
            previous_joints=target[:, 0],
            goal_location=target[:, -1, 21].contiguous(),
        ),
        torch.full((len(noise),), noise.shape[1]),
        noise,
        settings,
        seeds=range(len(noise)),
        objective=keyframes,
        watch=watch,
    )


def test_kept_steps_are_those_of_the_reference(arrays):
    from prbench_adapters.diffusion.sampling import CosineSchedule

    assert CosineSchedule(1000).kept_steps(10).tolist() == arrays["kept_steps"].tolist()


def test_the_noise_after_five_steps(arrays, solved):
    assert solved.noises[5].shape == golden.features(arrays["z_after_5"]).shape
    torch.testing.assert_close(solved.noises[5], golden.features(arrays["z_after_5"]), rtol=0, atol=1e-5)


def test_losses_decorrelation_and_gradient_norms_of_all_iterations(arrays, solved):
    minimised = torch.stack([losses.minimised.detach() for losses in solved.losses], dim=1)
    np.testing.assert_allclose(minimised, arrays["loss"], rtol=0, atol=2e-4)
    of_all = {name: [numbers[name] for numbers in solved.numbers] for name in solved.numbers[0]}
    decorrelated = torch.stack(of_all["decorrelation"], dim=1).detach()
    np.testing.assert_allclose(decorrelated, arrays["decorrelation"], rtol=0, atol=2e-6)
    norms = torch.stack(of_all["gradient_norm"], dim=1)
    np.testing.assert_allclose(norms[:, :20], arrays["grad_norm"][:, :20], rtol=1e-3)  # then chaotic
    np.testing.assert_allclose(of_all["learning_rate"], arrays["lr"], rtol=0, atol=1e-12)


def test_the_last_noise(arrays, solved):
    torch.testing.assert_close(solved.found.noise, golden.features(arrays["z_final"]), rtol=0, atol=2e-2)


def test_guided_passes_are_counted_twice_and_the_last_decoding_too(solved):
    assert solved.found.network_passes.tolist() == [61 * 10 * 2] * 2


@pytest.mark.parametrize("size", [64, 128])
def test_decorrelation_equals_the_reference(samples, size):
    with np.load(samples / "metrics" / "noise_optimisation.npz", allow_pickle=False) as file:
        noise, expected = file[f"z{size}"], file[f"loss{size}"]
    frames_first = torch.from_numpy(noise[:, :, 0]).transpose(1, 2).double()
    np.testing.assert_allclose(decorrelation(frames_first).numpy(), expected, rtol=0, atol=1e-8)


def test_learning_rate_factors_equal_the_reference(samples):
    with np.load(samples / "metrics" / "noise_optimisation.npz", allow_pickle=False) as file:
        iterations, expected = int(file["steps"]), file["lr_factor"]
    ours = [learning_rate_factor(step, warmup=50, iterations=iterations) for step in range(iterations + 1)]
    np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)
