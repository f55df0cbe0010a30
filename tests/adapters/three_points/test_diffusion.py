from __future__ import annotations

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch
from torch import Tensor

from prbench_adapters.three_points.diffusion import (
    BoDiffusion,
    DiffusionConfiguration,
    TrackDiffusion,
    noised,
    sample,
    turned,
    window_places,
)
from prbench_adapters.three_points.features import TrackWindows, columns_of, matrices_of_columns

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


@pytest.fixture(scope="module")
def arrays(samples: Path) -> dict[str, Tensor]:
    """The public program's values; sizes come from the file."""
    with np.load(samples / "nymeria-tasks" / "bodiffusion.npz") as file:
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


def test_loss_meets_the_golden_values(arrays: dict[str, Tensor]) -> None:
    network = _network(arrays, 1000)
    losses = network.loss(_ours(arrays["x0"]), arrays["features"], arrays["t"], _ours(arrays["noise"]))
    assert 0 in arrays["t"]  # the file shows the likelihood of clean values too
    for name in ("mse", "vb", "loss"):
        worst = ((losses[name] - arrays[name]).abs() / (1.0 + arrays[name])).max()
        assert float(worst) < 5e-6, name


def test_sampling_of_a_longer_sequence_meets_the_golden_states(arrays: dict[str, Tensor]) -> None:
    network = _network(arrays, int(arrays["sampling_steps"]))
    features, slide = arrays["sampling_features"], int(arrays["window_slide"])
    places = window_places(len(features), len(network.places), slide)
    drawn = iter(_ours(arrays["sampling_noise"]))
    seen: list[Tensor] = []
    estimate = network.estimate
    network.estimate = lambda noisy, *rest: (seen.append(noisy), estimate(noisy, *rest))[1]
    same = torch.eye(3).expand(len(places), 3, 3)
    result = sample(network, features[places], places, lambda: next(drawn), int(arrays["sampling_steps"]), same)
    assert next(drawn, None) is None  # as many draws as the file has
    states = torch.stack([seen[int(index)] for index in arrays["state_index"]])
    torch.testing.assert_close(_published(states), arrays["sampling_windows"], rtol=0, atol=3e-5)
    torch.testing.assert_close(_published(result), arrays["sampling_result"], rtol=0, atol=3e-5)


SMALL = DiffusionConfiguration(
    network="frames", width=8, heads=2, layers=1, window=6, slide=3, diffusion_steps=8, sampling_steps=4
)
PUBLISHED = msgspec.structs.replace(SMALL, network="published", diffusion_steps=60, sampling_steps=60)


def _drawn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def _rotations(count: int) -> Tensor:
    return columns_of(matrices_of_columns(_drawn(count, 22, 6)))


def _turns(count: int) -> Tensor:
    return matrices_of_columns(_drawn(count, 6, seed=1))


def _trained(configuration: DiffusionConfiguration) -> TrackDiffusion:
    """A network that answers something: layers that start at zero are filled."""
    torch.manual_seed(0)
    network = TrackDiffusion(configuration).eval()
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    return network


@pytest.mark.parametrize(("frames", "starts"), [(4, [0]), (6, [0]), (7, [0, 1]), (12, [0, 3, 6]), (13, [0, 3, 6, 7])])
def test_windows_cover_a_track_and_the_last_ends_with_it(frames: int, starts: list[int]) -> None:
    places = window_places(frames, 6, 3)
    assert places[:, 0].tolist() == starts
    assert places.unique().tolist() == list(range(frames))
    assert (places.diff(dim=1) == 1).all()


@pytest.mark.parametrize("configuration", [SMALL, PUBLISHED], ids=["frames", "published"])
def test_sampling_finds_what_all_windows_agree_on_in_their_own_frames(configuration: DiffusionConfiguration) -> None:
    truth = _rotations(14)
    places = window_places(14, 6, 3)
    turn = _turns(len(places))
    network = TrackDiffusion(configuration).denoiser
    tiny = torch.full((len(places), 6, 22, 6), -60.0)  # logarithm of a variance
    network.estimate = lambda *_: (turned(truth[places], turn.mT), tiny)  # pyright: ignore[reportAttributeAccessIssue]
    features = torch.zeros(len(places), 6, 54)
    found = sample(network, features, places, lambda: _drawn(14, 22, 6), configuration.sampling_steps, turn)
    torch.testing.assert_close(found, truth, rtol=0, atol=1e-5)


def test_a_track_and_its_windows_turned_together_give_the_same_body_turned() -> None:
    network = _trained(SMALL).denoiser
    places = window_places(14, 6, 3)
    turn = _turns(len(places))
    world = matrices_of_columns(_drawn(6, seed=3))
    features, start = _drawn(len(places), 6, 54), _drawn(14, 22, 6)
    here = sample(network, features, places, lambda: start, 4, turn)
    start_there = turned(start[None], world[None])[0]
    there = sample(network, features, places, lambda: start_there, 4, world @ turn)
    torch.testing.assert_close(there, turned(here[None], world[None])[0], rtol=0, atol=1e-5)
    assert not torch.allclose(there, here, atol=0.1)


def test_windows_of_the_small_denoiser_fade_in_and_out() -> None:
    network = TrackDiffusion(SMALL).denoiser
    places = window_places(9, 6, 3)
    answers = torch.stack([torch.zeros(6, 22, 6), torch.ones(6, 22, 6)])
    network.estimate = lambda *_: (answers, None)  # pyright: ignore[reportAttributeAccessIssue]
    same = torch.eye(3).expand(2, 3, 3)
    found = sample(network, torch.zeros(2, 6, 54), places, lambda: _drawn(9, 22, 6), 1, same)
    # Weights 1 2 3 3 2 1 of both, three frames apart.
    assert found[:, 5, 0].tolist() == pytest.approx([0, 0, 0, 1 / 4, 2 / 4, 3 / 4, 1, 1, 1])


@pytest.mark.parametrize("configuration", [SMALL, PUBLISHED], ids=["frames", "published"])
def test_a_seed_decides_all_that_is_drawn(configuration: DiffusionConfiguration) -> None:
    network = _trained(configuration)
    rows = _drawn(11, 54)
    first, again, other = (network.rotations(rows, seed) for seed in (5, 5, 6))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert network.rotations(rows[:4], 5).shape == (4, 22, 3, 3)  # shorter than a window


@pytest.mark.parametrize("configuration", [SMALL, PUBLISHED], ids=["frames", "published"])
def test_each_parameter_learns(configuration: DiffusionConfiguration) -> None:
    network = _trained(configuration).train()
    clean = _rotations(12).unflatten(0, (2, 6))
    batch = TrackWindows(_drawn(2, 6, 54), clean, _drawn(2, 6, 3), _drawn(2, 22, 3))
    network.losses(batch, torch.Generator().manual_seed(0))["loss"].backward()
    still = [name for name, each in network.named_parameters() if each.grad is None or not each.grad.any()]
    assert not still


def test_the_bound_trains_the_variance_alone() -> None:
    network = BoDiffusion(PUBLISHED)
    clean = _rotations(12).unflatten(0, (2, 6))
    losses = network.loss(clean, _drawn(2, 6, 54), torch.tensor([0, 30]), _drawn(2, 6, 22, 6, seed=4))
    losses["vb"].sum().backward()
    assert network.joint_head.bias.grad is not None
    of_noise, of_variance = network.joint_head.bias.grad.chunk(2)
    assert not of_noise.any()
    assert of_variance.all()


def test_the_default_is_as_large_as_the_published_network() -> None:
    count = sum(each.numel() for each in TrackDiffusion(DiffusionConfiguration()).parameters())
    assert round(count / 1e6, 2) == 21.94


@pytest.mark.parametrize(
    "changes",
    [
        {"heads": 3},
        {"width": 9, "heads": 1},
        {"slide": 7},
        {"sampling_steps": 9},
        {"diffusion_steps": 1},
        {"layers": 0},
    ],
)
def test_impossible_sizes_are_refused(changes: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="found"):
        msgspec.structs.replace(SMALL, **changes)
