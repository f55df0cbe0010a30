"""CVAE and DLow: the values of the published program, sizes, and what holds for any weights."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.recurrent import CVAE, CVAEConfiguration, DLow, DLowConfiguration, last_state
from tests.adapters.prediction.golden import agree, agree_in_gradient, agree_in_size, load, load_cvae, load_dlow, tensor


def _count(module):
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize(("joints", "expected"), [(21, 745_587), (23, 753_705)])
def test_published_numbers_of_parameters(joints, expected):
    cvae = CVAE(CVAEConfiguration(n_joints=joints))
    dlow = DLow(DLowConfiguration(), cvae)
    assert _count(cvae) == expected
    assert joints == 23 or _count(dlow) - _count(cvae) == 7_297_408


def test_dlow_diversity_grows_with_the_body_unless_told():
    cvae = CVAE(CVAEConfiguration(n_joints=21, state=4, mlp=(4,), latent=3))
    small = {"n_samples": 3, "state": 4, "mlp": (4,)}
    assert DLow(DLowConfiguration(**small), cvae).scale == pytest.approx(20 * 63 / 42)
    assert DLow(DLowConfiguration(**small, scale_by_size=False), cvae).scale == 20


def test_dlow_survives_a_scale_of_zero():
    cvae = CVAE(CVAEConfiguration(n_joints=2, predicted=4, state=4, mlp=(4,), latent=3))
    model = DLow(DLowConfiguration(n_samples=2, state=4, mlp=(4,)), cvae)
    for parameter in model.scales.parameters():
        torch.nn.init.zeros_(parameter)
    loss = model.loss(torch.randn(2, 5, 2, 3), torch.randn(2, 4, 2, 3), torch.randn(2, 3))["loss"]
    loss.backward()
    assert all(p.grad.isfinite().all() for p in model.parameters() if p.requires_grad)


@pytest.mark.parametrize(
    ("configuration", "message"),
    [
        (lambda: DLowConfiguration(n_samples=1), "'n_samples' must be at least 2"),
        (lambda: CVAEConfiguration(n_joints=2, mlp=()), "'mlp' must be one or more positive widths"),
    ],
)
def test_sizes_that_make_no_network_are_refused(configuration, message):
    with pytest.raises(ValueError, match=message):
        configuration()


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
    coming = last_state(model.future, future.flatten(2))
    agree(arrays, TOLERANCE, past_state=past, future_state=coming, decoder_state=model.decoder.first_state(past))
    mean, log_variance = model.posterior_of(observed, future)
    latent = mean + (0.5 * log_variance).exp() * tensor(arrays["eps"])
    agree(arrays, TOLERANCE, mu=mean, logvar=log_variance, z=latent)
    decoded = model.decode(observed, torch.stack([latent, mean, tensor(arrays["prior_z"])], dim=1))
    names = ("reconstruction", "reconstruction_mean", "prediction_prior")
    agree(arrays, TOLERANCE, **dict(zip(names, decoded.unbind(dim=1), strict=True)))


def test_cvae_loss_and_gradient(samples):
    arrays = load(samples, "dlow_cvae")
    model = _cvae(arrays)
    loss = model.loss(*(tensor(arrays[name]) for name in ("observed", "future", "eps")))
    parts = {
        "loss_squared_error": loss["squared_error"],
        "loss_first_frame": loss["first_frame"],
        "loss_kl": loss["kl"],
    }
    agree_in_size(arrays, loss=loss["loss"], **parts)
    loss["loss"].backward()
    agree_in_gradient(arrays, model)
    gradients = {"grad_output_bias": model.decoder.output.bias, "grad_past_weight_ih": model.past.weight_ih_l0}
    for name, parameter in gradients.items():
        agree(arrays, 1e-4 * np.abs(arrays[name]).max(), **{name: parameter.grad})


def test_dlow(samples):
    arrays = load(samples, "dlow_sampler")
    configuration = DLowConfiguration(
        n_samples=int(arrays["n_samples"]),
        state=int(arrays["sampler_width_state"]),
        mlp=tuple(arrays["sampler_width_mlp"].tolist()),
        **{name: float(arrays[f"lambda_{name}"]) for name in ("kl", "diversity", "best_of_k")},
        scale=float(arrays["diversity_scale"]),
        scale_by_size=False,
    )
    model = DLow(configuration, CVAE(CVAEConfiguration(**_sizes(arrays))))
    load_dlow(model, arrays)
    observed, future, noise = (tensor(arrays[name]) for name in ("observed", "future", "eps"))
    scale, shift = model.maps(observed)
    agree(arrays, TOLERANCE, past_state=last_state(model.past, observed.flatten(2)), a=scale, b=shift)
    agree(arrays, TOLERANCE, z=scale * noise[:, None] + shift, prediction=model.decode(observed, noise))
    loss = model.loss(observed, future, noise)
    parts = {f"loss_{name}": loss[name] for name in ("kl", "diversity", "best_of_k")}
    agree_in_size(arrays, loss=loss["loss"], **parts)
    loss["loss"].backward()
    agree_in_gradient(arrays, model)
    limit = 1e-4 * np.abs(arrays["grad_head_b_bias"]).max()
    agree(arrays, limit, grad_head_b_bias=model.shifts.bias.grad)
    assert all(parameter.grad is None for parameter in model.cvae.parameters())
