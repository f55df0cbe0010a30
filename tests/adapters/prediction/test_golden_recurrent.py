"""CVAE and DLow give the values, losses and gradients of the published program."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.recurrent import (
    CVAE,
    CVAEConfiguration,
    DLow,
    DLowConfiguration,
    last_state,
)
from tests.adapters.prediction.golden import largest_difference, load, load_cvae, load_dlow, tensor

TOLERANCE = 5e-6


def _sizes(arrays):
    return {
        "n_joints": int(arrays["n_joints"]),
        "predicted": int(arrays["n_predicted"]),
        "state": int(arrays["width_state"]),
        "mlp": tuple(arrays["width_mlp"].tolist()),
        "latent": int(arrays["width_latent"]),
    }


def _cvae(arrays):
    model = CVAE(
        CVAEConfiguration(**_sizes(arrays), first_frame=float(arrays["lambda_first_frame"]), beta=float(arrays["beta"]))
    )
    load_cvae(model, arrays)
    return model


def test_cvae_states_and_reconstructions(samples):
    arrays = load(samples, "dlow_cvae")
    model = _cvae(arrays)
    observed, future = tensor(arrays["observed"]), tensor(arrays["future"])
    past = last_state(model.past, observed.flatten(2))
    assert largest_difference(past, arrays["past_state"]) < TOLERANCE
    assert largest_difference(last_state(model.future, future.flatten(2)), arrays["future_state"]) < TOLERANCE
    assert largest_difference(model.decoder.first_state(past), arrays["decoder_state"]) < TOLERANCE
    mean, log_variance = model.posterior_of(observed, future)
    assert largest_difference(mean, arrays["mu"]) < TOLERANCE
    assert largest_difference(log_variance, arrays["logvar"]) < TOLERANCE
    latent = mean + (0.5 * log_variance).exp() * tensor(arrays["eps"])
    assert largest_difference(latent, arrays["z"]) < TOLERANCE
    decoded = model.decode(observed, torch.stack([latent, mean, tensor(arrays["prior_z"])], dim=1))
    for place, name in enumerate(("reconstruction", "reconstruction_mean", "prediction_prior")):
        assert largest_difference(decoded[:, place], arrays[name]) < TOLERANCE


def test_cvae_loss_and_gradient(samples):
    arrays = load(samples, "dlow_cvae")
    model = _cvae(arrays)
    loss = model.loss(*(tensor(arrays[name]) for name in ("observed", "future", "eps")))
    for found, name in (
        (loss["squared_error"], "_squared_error"),
        (loss["first_frame"], "_first_frame"),
        (loss["kl"], "_kl"),
    ):
        assert found.item() == pytest.approx(float(arrays[f"loss{name}"]), rel=1e-5)
    assert loss["loss"].item() == pytest.approx(float(arrays["loss"]), rel=1e-5)
    loss["loss"].backward()
    norm = torch.stack([parameter.grad.norm() for parameter in model.parameters()]).norm()
    assert norm.item() == pytest.approx(float(arrays["grad_norm"]), rel=1e-4)
    for found, name in (
        (model.decoder.output.bias.grad, "grad_output_bias"),
        (model.past.weight_ih_l0.grad, "grad_past_weight_ih"),
    ):
        assert largest_difference(found, arrays[name]) < 1e-4 * np.abs(arrays[name]).max()


def test_dlow(samples):
    arrays = load(samples, "dlow_sampler")
    configuration = DLowConfiguration(
        n_samples=int(arrays["n_samples"]),
        state=int(arrays["sampler_width_state"]),
        mlp=tuple(arrays["sampler_width_mlp"].tolist()),
        kl=float(arrays["lambda_kl"]),
        diversity=float(arrays["lambda_diversity"]),
        best_of_k=float(arrays["lambda_best_of_k"]),
        scale=float(arrays["diversity_scale"]),
        scale_by_size=False,
    )
    model = DLow(configuration, CVAE(CVAEConfiguration(**_sizes(arrays))))
    load_dlow(model, arrays)
    observed, future, noise = (tensor(arrays[name]) for name in ("observed", "future", "eps"))
    assert largest_difference(last_state(model.past, observed.flatten(2)), arrays["past_state"]) < TOLERANCE
    scale, shift = model.maps(observed)
    assert largest_difference(scale, arrays["a"]) < TOLERANCE
    assert largest_difference(shift, arrays["b"]) < TOLERANCE
    assert largest_difference(scale * noise[:, None] + shift, arrays["z"]) < TOLERANCE
    assert largest_difference(model.decode(observed, noise), arrays["prediction"]) < TOLERANCE
    loss = model.loss(observed, future, noise)
    for found, name in ((loss["kl"], "_kl"), (loss["diversity"], "_diversity"), (loss["best_of_k"], "_best_of_k")):
        assert found.item() == pytest.approx(float(arrays[f"loss{name}"]), rel=1e-5)
    assert loss["loss"].item() == pytest.approx(float(arrays["loss"]), rel=1e-5)
    loss["loss"].backward()
    gradients = [parameter.grad for parameter in model.parameters() if parameter.requires_grad]
    norm = torch.stack([gradient.norm() for gradient in gradients]).norm()
    assert norm.item() == pytest.approx(float(arrays["grad_norm"]), rel=1e-4)
    limit = 1e-4 * np.abs(arrays["grad_head_b_bias"]).max()
    assert largest_difference(model.shifts.bias.grad, arrays["grad_head_b_bias"]) < limit
    assert all(parameter.grad is None for parameter in model.cvae.parameters())
