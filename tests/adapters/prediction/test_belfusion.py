"""BeLFusion: the values of the published program, sizes, and what holds for any weights."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.belfusion import (
    BehaviourAutoencoder,
    BehaviourConfiguration,
    BeLFusion,
    PastAutoencoder,
    UNetConfiguration,
)
from tests.adapters.prediction.golden import largest_difference, load, load_behaviour, load_past, load_unet, tensor

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
    assert largest_difference(model.code(observed[:, 1:]), arrays["observation_code"]) < AUTOENCODER
    assert largest_difference(model(observed), arrays["observation_reconstruction"]) < AUTOENCODER
    assert model.loss(observed).item() == pytest.approx(float(arrays["loss_autoencoder"]), rel=1e-5)


def test_behaviour(samples):
    arrays = load(samples, "belfusion_autoencoders")
    configuration = _configuration(arrays)
    model = BehaviourAutoencoder(configuration)
    load_behaviour(model, arrays)
    start = configuration.observed - configuration.context
    sequence = tensor(arrays["motion"])[:, start:]
    noise = tensor(arrays["behaviour_noise"])
    mean, log_deviation = model.encode(sequence)
    drawn = model.draw(sequence, noise)
    for value, name in ((mean, "mu"), (log_deviation, "log_std"), (drawn, "behaviour")):
        assert largest_difference(value, arrays[name]) < AUTOENCODER
    context = sequence[:, : configuration.context]
    decoded = model.decode(context, drawn[:, None])[:, 0]
    assert largest_difference(torch.cat([context, decoded], dim=1), arrays["reconstruction"]) < AUTOENCODER
    auxiliary = model.decode_without_context(drawn)
    assert largest_difference(auxiliary, arrays["auxiliary_reconstruction"]) < AUTOENCODER
    transferred = model.decode(context.flip(0), drawn[:, None])[:, 0]
    assert largest_difference(transferred, arrays["transferred"]) < AUTOENCODER
    loss = model.loss(sequence, noise)
    # The value that the published program prints; ours counts the auxiliary decoder's own error, with its gradients.
    published = loss["squared_error"] + configuration.beta * loss["kl"] - configuration.delta * loss["auxiliary"]
    for value, name in (
        (loss["squared_error"], "loss_squared_error"),
        (loss["kl"], "loss_kl_as_coded"),
        (loss["auxiliary"], "loss_auxiliary"),
        (published, "loss"),
    ):
        assert value.item() == pytest.approx(float(arrays[name]), rel=1e-5)


def _belfusion(arrays):
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
    model = _belfusion(arrays)
    np.testing.assert_allclose(model.schedule.alphas_cumprod, arrays["alpha_bar"], rtol=0, atol=1e-12)
    motion, step, noise = (tensor(arrays[name]) for name in ("motion", "t", "training_noise"))
    observed = motion[:, : model.configuration.observed]
    condition = model.condition(observed)
    target = model.target(motion, tensor(arrays["behaviour_noise"]))
    assert largest_difference(condition, arrays["condition"]) < DENOISER
    assert largest_difference(target, arrays["target"]) < DENOISER
    level = tensor(arrays["alpha_bar"]).float()[step][:, None, None]
    noisy = level.sqrt() * target[:, None] + (1 - level).sqrt() * noise
    assert largest_difference(noisy, arrays["x_t"]) < DENOISER
    clean = model.denoised(tensor(arrays["x_t"]), step, tensor(arrays["condition"]))
    assert largest_difference(clean, arrays["x0"]) < DENOISER
    assert largest_difference(model.decode(observed, clean), arrays["x0_decoded"]) < DENOISER
    assert largest_difference(model.decode(observed, target[:, None])[:, 0], arrays["target_decoded"]) < DENOISER
    loss = model.loss(motion, step, noise, tensor(arrays["behaviour_noise"]))
    for found, name in ((loss["latent"], "loss_latent"), (loss["decoded"], "loss_decoded"), (loss["loss"], "loss")):
        np.testing.assert_allclose(found.detach().numpy(), arrays[name], rtol=1e-5)


def test_sampling_of_behaviours(samples):
    arrays = load(samples, "belfusion_denoiser")
    model = _belfusion(arrays)
    observed = tensor(arrays["motion"])[:, : model.configuration.observed]
    start = tensor(arrays["start_noise"])[:, None]
    states, clean = zip(*model.states(start, tensor(arrays["condition"])))
    assert largest_difference(torch.cat(states, dim=1), arrays["sampled_latent"]) < DENOISER
    assert largest_difference(torch.cat(clean, dim=1), arrays["sampled_x0"]) < DENOISER
    assert largest_difference(model.decode(observed, clean[-1])[:, 0], arrays["prediction"]) < DENOISER
