"""CVAE, DLow and BeLFusion: sizes, and what holds for any weights."""

from __future__ import annotations

import pytest
import torch

from prbench_adapters.prediction.belfusion import (
    BehaviourConfiguration,
    BeLFusion,
    LatentUNet,
    PastAutoencoder,
    UNetConfiguration,
)
from prbench_adapters.prediction.recurrent import CVAE, CVAEConfiguration, DLow, DLowConfiguration


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
