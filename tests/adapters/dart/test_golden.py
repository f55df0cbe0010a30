"""DART's published program on tiny networks: a denoiser's pass, and three primitives with everything in between."""

from __future__ import annotations

import pytest
import torch

from prbench_adapters.dart.model import Placement
from prbench_adapters.dart.rollout import GuidedDenoiser, Primitive, by_ddim, roll_out
from tests.adapters.dart import golden

TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def arrays(samples):
    return golden.load(samples)


@pytest.fixture(scope="module")
def primitives(arrays) -> list[Primitive]:
    model, history = golden.model(arrays), golden.tensor(arrays, "history")
    text = golden.tensor(arrays, "text").expand(len(history), -1)
    denoiser = GuidedDenoiser(model.denoiser, text, float(arrays["guidance"]))
    identity = Placement(torch.eye(3).expand(2, 3, 3), torch.zeros(2, 3))
    return roll_out(model, history, identity, by_ddim(denoiser, model.schedule, golden.tensor(arrays, "noise")), 3)


def _equal(actual, expected):
    torch.testing.assert_close(actual, expected, rtol=0, atol=TOLERANCE)


def test_a_pass_of_the_denoiser_gives_the_clean_latent_of_the_reference(arrays):
    model = golden.model(arrays)
    x_t, step, history = (golden.tensor(arrays, name) for name in ("x_t", "t", "history"))
    text = golden.tensor(arrays, "text").expand(len(x_t), -1)
    _equal(model.denoiser(x_t, step, text, history), golden.tensor(arrays, "x0"))


def test_each_primitive_starts_from_the_history_of_the_reference(arrays, primitives):
    _equal(torch.stack([each.history for each in primitives]), golden.tensor(arrays, "primitive_history"))


def test_guided_ddim_gives_the_latents_of_the_reference(arrays, primitives):
    _equal(torch.stack([each.latent for each in primitives]), golden.tensor(arrays, "primitive_latents"))


def test_the_decoder_gives_the_features_of_the_reference(arrays, primitives):
    mean, std = golden.tensor(arrays, "mean"), golden.tensor(arrays, "std")
    features = torch.stack([each.features for each in primitives]) * std + mean
    _equal(features, golden.tensor(arrays, "primitive_features"))


def test_the_frames_of_reference_stand_where_those_of_the_reference_do(arrays, primitives):
    _equal(torch.stack([each.placement.rotation for each in primitives]), golden.tensor(arrays, "primitive_rotation"))
    origins = torch.stack([each.placement.origin for each in primitives])
    _equal(origins, golden.tensor(arrays, "primitive_origin")[:, :, 0])


def test_joints_in_the_world_are_those_of_the_reference(arrays, primitives):
    first = primitives[0].placement.points(golden.model(arrays).scaling.frames(primitives[0].history).joints)
    joints = torch.cat([first, *(each.joints for each in primitives)], dim=1)
    _equal(joints, golden.tensor(arrays, "world_joints"))
