from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from prbench_adapters.three_points.diffusion import BoDiffusion, DiffusionConfiguration, noised, sample, window_places

GOLDEN = Path(os.environ.get("PRBENCH_SAMPLES", "/nowhere")) / "nymeria-tasks" / "bodiffusion.npz"
_NAMES = (
    (r"^pos_embed$", "places"),
    (r"^input_process\.poseEmbedding", "frame_embedding"),
    (r"attn\.qkv", "attention.query_key_value"),
    (r"attn\.proj", "attention.output"),
    (r"mlp\.fc1", "feed_forward.0"),
    (r"mlp\.fc2", "feed_forward.2"),
    (r"adaLN_modulation\.1", "modulation"),
    (r"^out\.poseFinal", "frame_head"),
    (r"^out\.featsFinal", "joint_head"),
    (r"^embed_timestep\.mlp", "time_embedding"),
    (r"^cond_emb\.projections", "condition"),
)
golden = pytest.mark.skipif(not GOLDEN.is_file(), reason="PRBENCH_SAMPLES holds no golden arrays of BoDiffusion")


@pytest.fixture(scope="module")
def arrays() -> dict[str, Tensor]:
    with np.load(GOLDEN) as file:
        found = {name: torch.from_numpy(file[name]) for name in file.files}
    return {name: values.float() if values.is_floating_point() else values for name, values in found.items()}


def _network(arrays: dict[str, Tensor], diffusion_steps: int) -> BoDiffusion:
    """The tiny network of the file; sizes come from its weights."""
    weights = {name.removeprefix("w/"): values for name, values in arrays.items() if name.startswith("w/")}
    for published, ours in _NAMES:
        weights = {re.sub(published, ours, name): values for name, values in weights.items()}
    _, window, width = weights["places"].shape
    layers = sum(name.endswith("modulation.bias") for name in weights)
    sizes = {"width": width, "heads": int(arrays["heads"]), "layers": layers, "window": window}
    configuration = DiffusionConfiguration(**sizes, diffusion_steps=diffusion_steps, sampling_steps=1, slide=1)
    network = BoDiffusion(configuration)
    weights["places"] = weights["places"][0]
    network.load_state_dict(weights)
    return network.eval().requires_grad_(False)


def _published(rotations: Tensor) -> Tensor:
    """Our (…, frames, joints, values) as the published (…, values, frames, joints)."""
    return rotations.movedim(-1, -3)


def _ours(rotations: Tensor) -> Tensor:
    return rotations.movedim(-3, -1)


@golden
def test_one_pass_meets_the_golden_arrays(arrays: dict[str, Tensor]) -> None:
    network = _network(arrays, 1000)
    step, features = arrays["t"], arrays["features"]
    noisy = noised(_ours(arrays["x0"]), network.schedule, step, _ours(arrays["noise"]))
    clean, log_variance = network.estimate(noisy, features, network.schedule, step)
    factors = [
        torch.from_numpy(each)[step].float().view(-1, 1, 1, 1)
        for each in (network.schedule.posterior_mean_clean, network.schedule.posterior_mean_noisy)
    ]
    found = {
        "condition": network.told(features),
        "x_t": noisy,
        "model_output": network(noisy, features, step),
        "log_variance": log_variance,
        "mean": factors[0] * clean + factors[1] * noisy,
    }
    for name, values in found.items():
        torch.testing.assert_close(_published(values), arrays[name], rtol=0, atol=2.5e-5)
    torch.testing.assert_close(_published(clean), arrays["pred_x0"], rtol=0, atol=3e-3)
    time = network.time_embedding(network.sinusoid[step])
    torch.testing.assert_close(time, arrays["time_embedding"], rtol=0, atol=2.5e-5)


@golden
def test_loss_meets_the_golden_values_and_trains_the_variance_alone_by_the_bound(arrays: dict[str, Tensor]) -> None:
    network = _network(arrays, 1000)
    losses = network.loss(_ours(arrays["x0"]), arrays["features"], arrays["t"], _ours(arrays["noise"]))
    assert 0 in arrays["t"]  # the file shows the likelihood of clean values too
    for name in ("mse", "vb", "loss"):
        worst = ((losses[name] - arrays[name]).abs() / (1.0 + arrays[name])).max()
        assert float(worst) < 5e-6, name


@golden
def test_sampling_of_a_longer_sequence_meets_the_golden_states(arrays: dict[str, Tensor]) -> None:
    network = _network(arrays, int(arrays["sampling_steps"]))
    features, slide = arrays["sampling_features"], int(arrays["window_slide"])
    places = window_places(len(features), len(network.places), slide)
    drawn = iter(_ours(arrays["sampling_noise"]))
    seen: list[Tensor] = []
    estimate = network.estimate
    network.estimate = lambda noisy, *rest: (seen.append(noisy), estimate(noisy, *rest))[1]
    result = sample(
        network, features[places], places, next(drawn), noise=lambda: next(drawn), steps=int(arrays["sampling_steps"])
    )
    assert next(drawn, None) is None  # as many draws as the file has
    states = torch.stack([seen[int(index)] for index in arrays["state_index"]])
    torch.testing.assert_close(_published(states), arrays["sampling_windows"], rtol=0, atol=3e-5)
    torch.testing.assert_close(_published(result), arrays["sampling_result"], rtol=0, atol=3e-5)
