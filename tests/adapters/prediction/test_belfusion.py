"""BeLFusion: the values of the published program, sizes, and what holds for any weights."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.belfusion import (
    BehaviourAutoencoder,
    BehaviourConfiguration,
    BeLFusion,
    LatentUNet,
    PastAutoencoder,
    UNetConfiguration,
)
from tests.adapters.prediction.golden import agree, agree_in_size, load, load_behaviour, load_past, load_unet, tensor

AUTOENCODER, DENOISER = 5e-6, 1e-5


def _configuration(arrays):
    weights = {name: float(arrays[name]) for name in ("beta", "delta") if name in arrays}
    return BehaviourConfiguration(
        n_joints=int(arrays["n_joints"]),
        observed=int(arrays["n_observed"]),
        predicted=int(arrays["n_predicted"]),
        context=int(arrays["n_context"]),
        past=int(arrays["width_observation"]),
        mlp=tuple(arrays["width_mlp"].tolist()),
        offsets_summed=bool(arrays["observation_recurrent"]),
        behaviour=int(arrays["width_behaviour"]),
        decoder=int(arrays["width_decoder"]),
        context_width=int(arrays["width_context"]),
        **weights,
    )


def test_past_autoencoder(samples):
    arrays = load(samples, "belfusion_autoencoders")
    model = PastAutoencoder(_configuration(arrays))
    load_past(model, arrays)
    observed = tensor(arrays["motion"])[:, : model.configuration.observed + 1]
    code = model.code(observed[:, 1:])
    agree(arrays, AUTOENCODER, observation_code=code, observation_reconstruction=model(observed))
    agree_in_size(arrays, loss_autoencoder=model.loss(observed))


def test_behaviour(samples):
    arrays = load(samples, "belfusion_autoencoders")
    configuration = _configuration(arrays)
    model = BehaviourAutoencoder(configuration)
    load_behaviour(model, arrays)
    sequence = tensor(arrays["motion"])[:, configuration.observed - configuration.context :]
    noise = tensor(arrays["behaviour_noise"])
    mean, log_deviation = model.encode(sequence)
    drawn = model.draw(sequence, noise)
    agree(arrays, AUTOENCODER, mu=mean, log_std=log_deviation, behaviour=drawn)
    context = sequence[:, : configuration.context]
    decoded = torch.cat([context, model.decode(context, drawn[:, None])[:, 0]], dim=1)
    transferred = model.decode(context.flip(0), drawn[:, None])[:, 0]
    auxiliary = model.decode_without_context(drawn)
    agree(arrays, AUTOENCODER, reconstruction=decoded, transferred=transferred, auxiliary_reconstruction=auxiliary)
    loss = model.loss(sequence, noise)
    # The value that the published program prints; ours counts the auxiliary decoder's own error, with its gradients.
    published = loss["squared_error"] + configuration.beta * loss["kl"] - configuration.delta * loss["auxiliary"]
    parts = {"loss_squared_error": loss["squared_error"], "loss_kl_as_coded": loss["kl"]}
    agree_in_size(arrays, loss=published, loss_auxiliary=loss["auxiliary"], **parts)


def _golden_belfusion(arrays):
    unet = UNetConfiguration(
        height=int(arrays["latent_height"]),
        width=int(arrays["latent_width"]),
        channels=len(arrays["w/unet/input_blocks.0.0.weight"]),
        multiples=tuple(arrays["channel_multiples"].tolist()),
        attention_at=tuple(arrays["attention_at"].tolist()),
        head_channels=int(arrays["head_channels"]),
        condition=int(arrays["width_observation"]),
        steps=int(arrays["noise_steps"]),
    )
    model = BeLFusion(_configuration(arrays), unet, decoded_weight=float(arrays["decoded_weight"]))
    load_past(model.past, arrays)
    load_behaviour(model.behaviour, arrays)
    load_unet(model.denoiser, arrays)
    for ours, theirs in (("past", "observation"), ("behaviour", "behaviour")):
        for end in ("min", "max"):
            getattr(model, f"{ours}_{end}").copy_(tensor(arrays[f"{theirs}_{end}"]))
    return model


def test_diffusion_of_behaviours(samples):
    arrays = load(samples, "belfusion_denoiser")
    model = _golden_belfusion(arrays)
    np.testing.assert_allclose(model.schedule.alphas_cumprod, arrays["alpha_bar"], rtol=0, atol=1e-12)
    motion, step, noise = (tensor(arrays[name]) for name in ("motion", "t", "training_noise"))
    observed = motion[:, : model.configuration.observed]
    target = model.target(motion, tensor(arrays["behaviour_noise"]))
    level = tensor(arrays["alpha_bar"]).float()[step][:, None, None]
    noisy = level.sqrt() * target[:, None] + (1 - level).sqrt() * noise
    agree(arrays, DENOISER, condition=model.condition(observed), target=target, x_t=noisy)
    clean = model.denoised(tensor(arrays["x_t"]), step, tensor(arrays["condition"]))
    decoded = model.decode(observed, target[:, None])[:, 0]
    agree(arrays, DENOISER, x0=clean, x0_decoded=model.decode(observed, clean), target_decoded=decoded)
    loss = model.loss(motion, step, noise, tensor(arrays["behaviour_noise"]))
    agree_in_size(arrays, loss=loss["loss"], loss_latent=loss["latent"], loss_decoded=loss["decoded"])


def test_sampling_of_behaviours(samples):
    arrays = load(samples, "belfusion_denoiser")
    model = _golden_belfusion(arrays)
    observed = tensor(arrays["motion"])[:, : model.configuration.observed]
    start = tensor(arrays["start_noise"])[:, None]
    states, clean = zip(*model.states(start, tensor(arrays["condition"])))
    agree(arrays, DENOISER, sampled_latent=torch.cat(states, dim=1), sampled_x0=torch.cat(clean, dim=1))
    agree(arrays, DENOISER, prediction=model.decode(observed, clean[-1])[:, 0])


def test_published_number_of_parameters_of_the_latent_unet():
    assert sum(each.numel() for each in LatentUNet(UNetConfiguration()).parameters()) == 12_657_121


def _belfusion():
    torch.manual_seed(2)
    behaviour = BehaviourConfiguration(
        n_joints=2, observed=5, predicted=4, past=4, mlp=(4,), behaviour=8, decoder=4, context_width=4
    )
    unet = UNetConfiguration(height=4, width=2, multiples=(1, 1), attention_at=(2,), condition=4)
    return BeLFusion(behaviour, unet).eval()


def test_belfusion_samples_depend_on_their_seeds_alone():
    model = _belfusion()
    observed = torch.randn(2, 5, 2, 3)
    many = model.predict(observed, [[1, 2, 3], [4, 5, 6]])
    assert many.shape == (2, 3, 4, 2, 3)
    torch.testing.assert_close(model.predict(observed[1:], [[4, 5]])[0], many[1, :2])


def test_belfusion_trains_the_denoiser_alone():
    model = _belfusion()
    loss = model.loss(torch.randn(2, 9, 2, 3), torch.tensor([0, 9]), torch.randn(2, 3, 8), torch.randn(2, 8))
    loss["loss"].mean().backward()
    assert all(parameter.grad is None for parameter in (*model.past.parameters(), *model.behaviour.parameters()))
    assert all(parameter.grad is not None for parameter in model.denoiser.output.parameters())


@pytest.mark.parametrize(
    ("configuration", "message"),
    [
        (
            lambda: BeLFusion(BehaviourConfiguration(n_joints=2, behaviour=8), UNetConfiguration()),
            "behaviours of 128 and codes of 64 numbers, the autoencoders for 8 and 64",
        ),
        (lambda: UNetConfiguration(height=12), "must be multiples of 8"),
        (lambda: BehaviourConfiguration(n_joints=2, observed=2), "'context' must be at most the 2 observed frames"),
    ],
)
def test_parts_of_different_sizes_are_refused(configuration, message):
    with pytest.raises(ValueError, match=message):
        configuration()


def test_a_latent_unet_of_one_level_resizes_nothing():
    configuration = UNetConfiguration(height=3, width=5, multiples=(1,), attention_at=(), condition=4)
    network = LatentUNet(configuration)
    found = network(torch.randn(2, 15), torch.tensor([0, 9]), torch.randn(2, 4))
    assert torch.equal(found, torch.zeros(2, 15))  # its last layer starts at zero
    assert [len(stage) for stage in (*network.down, *network.up)] == [1, 1, 1]


def test_offsets_of_the_past_are_summed_or_added_to_the_first_pose():
    motion = torch.randn(2, 6, 2, 3)
    found = {}
    for summed in (False, True):
        torch.manual_seed(4)
        found[summed] = PastAutoencoder(BehaviourConfiguration(n_joints=2, observed=5, offsets_summed=summed))(motion)
    assert torch.equal(found[True][:, :1], motion[:, :1])
    offsets = found[False][:, 1:] - motion[:, :1]
    torch.testing.assert_close(found[True][:, 1:], motion[:, :1] + offsets.cumsum(dim=1))
