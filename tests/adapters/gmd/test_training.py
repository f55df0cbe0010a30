"""Training of both networks of GMD in one run: statistics, losses, draws."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.gmd.model import GMDModel, with_absolute_root
from prbench_adapters.training import SequenceDataset
from prbench_adapters.training.dataset import MotionBatch
from tests.adapters.trained import batch_of, build, saved, sequences


@pytest.fixture(scope="module")
def data() -> SequenceDataset:
    return sequences(max_frames=60)


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return batch_of(data)


def test_statistics_are_those_of_absolute_features(data):
    space = build("gmd", data).space(torch.device("cpu"))
    raw = torch.cat([with_absolute_root(torch.tensor(data[index].features)) for index in range(len(data))])
    assert torch.allclose(space.mean, raw.mean(dim=0), atol=1e-4)
    assert torch.allclose(space.std[1:3], raw[:, 1:3].std(dim=0, correction=0).mean().expand(2), rtol=1e-3)
    assert not np.allclose(space.std[:3].numpy(), data.statistics().std[:3], rtol=0.5)


def test_the_losses_of_untrained_networks_are_the_variances_of_what_they_predict(data, batch):
    """Networks that say zero: the trajectory's noise has variance 1, projected features about 1 as well."""
    module = build("gmd", data)
    for network in (module.networks.motion, module.networks.trajectory):
        torch.nn.init.zeros_(network.head[1].weight)
        torch.nn.init.zeros_(network.head[1].bias)
    losses = module(batch, 0)
    assert float(losses["trajectory"]) == pytest.approx(1.0, abs=0.1)
    assert 0.3 < float(losses["motion"]) < 3.0
    assert torch.equal(losses["loss"], losses["motion"] + losses["trajectory"])


def test_decoded_joints_are_part_of_the_loss_where_they_weigh(data, batch):
    plain = build("gmd", data)(batch, 0)
    weighed = build("gmd", data, joint_loss_weight=2.0, bone_loss_weight=3.0, path_step_weight=0.5)(batch, 0)
    assert "joints" not in plain
    parts = weighed["motion"] + weighed["trajectory"] + 2 * weighed["joints"] + 3 * weighed["bones"]
    assert torch.allclose(weighed["loss"], parts + 0.5 * weighed["path_steps"], rtol=1e-5)
    assert torch.allclose(weighed["motion"], plain["motion"])


def test_where_the_head_points_and_the_wrists_end_can_weigh(data, batch):
    found = build("gmd", data, ray_loss_weight=2.0, wrist_loss_weight=3.0)(batch, 0)
    parts = found["motion"] + found["trajectory"] + 2 * found["ray"] + 3 * found["wrists"]
    assert torch.allclose(found["loss"], parts, rtol=1e-5)


def test_a_network_that_knows_the_motion_has_no_loss_of_joints(data, batch):
    module = build("gmd", data, joint_loss_weight=1.0, bone_loss_weight=1.0, ray_loss_weight=1.0)
    space = module.space(torch.device("cpu"))
    projected = space.projected(space.standardised(with_absolute_root(batch.features)))
    found = module._motion_losses(projected, projected, batch, space)
    assert float(found["loss"]) < 1e-6


def test_text_is_hidden_as_often_as_asked(data, batch):
    module = build("gmd", data, text_drop=0.3)
    hidden = torch.cat([module.draw(batch.features, module.generator(step)).without_text for step in range(300)])
    assert float(hidden.float().mean()) == pytest.approx(0.3, abs=0.05)


def test_each_network_is_clipped_by_itself(data):
    module = build("gmd", data)
    networks = (module.networks.motion, module.networks.trajectory)
    assert [list(group) for group in module.gradient_groups()] == [list(network.parameters()) for network in networks]


def test_half_precision_keeps_the_projection_to_the_bit(data, tmp_path):
    module = build("gmd", data)
    model = GMDModel.load(saved(module, tmp_path / "half.safetensors", dtype="float16"))
    assert torch.equal(model.space.projection, module.space(torch.device("cpu")).projection)
    assert torch.equal(model.space.inverse, module.space(torch.device("cpu")).inverse)
