"""CVAE and DLow: the values of the published program, sizes, and what holds for any weights."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.prediction.belfusion import (
    BehaviourConfiguration,
    BeLFusion,
    LatentUNet,
    PastAutoencoder,
    UNetConfiguration,
)
from prbench_adapters.prediction.recurrent import CVAE, CVAEConfiguration, DLow, DLowConfiguration, last_state
from tests.adapters.prediction.golden import largest_difference, load, load_cvae, load_dlow, tensor


def _count(module):
    return sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize(("joints", "expected"), [(21, 745_587), (23, 753_705)])
def test_published_numbers_of_parameters(joints, expected):
    cvae = CVAE(CVAEConfiguration(n_joints=joints))
    dlow = DLow(DLowConfiguration(), cvae)
    assert _count(cvae) == expected
    assert joints == 23 or _count(dlow) - _count(cvae) == 7_297_408


def test_published_number_of_parameters_of_the_latent_unet():
    assert _count(LatentUNet(UNetConfiguration())) == 12_657_121


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


def test_parts_of_different_sizes_are_refused():
    with pytest.raises(ValueError, match="behaviours of 128 and codes of 64 numbers, the autoencoders for 8 and 64"):
        BeLFusion(BehaviourConfiguration(n_joints=2, behaviour=8), UNetConfiguration())
    with pytest.raises(ValueError, match="must be multiples of 8"):
        UNetConfiguration(height=12)
    with pytest.raises(ValueError, match="'context' must be at most the 2 observed frames"):
        BehaviourConfiguration(n_joints=2, observed=2)
    with pytest.raises(ValueError, match="'n_samples' must be at least 2"):
        DLowConfiguration(n_samples=1)
    with pytest.raises(ValueError, match="'mlp' must be one or more positive widths"):
        CVAEConfiguration(n_joints=2, mlp=())


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
