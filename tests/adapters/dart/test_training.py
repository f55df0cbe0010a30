"""Training of DART: windows, phases, and what each loss is zero for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench_adapters.dart.model import DartConfiguration, Frames
from prbench_adapters.dart.training import (
    DartTraining,
    body_losses,
    delta_loss,
    divergence,
    drawn_starts,
    feedback,
    primitives_of,
    window,
)
from prbench_adapters.kinematics import rest_offsets
from prbench_adapters.training import SequenceDataset
from prbench_adapters.training.configuration import OptimisationConfiguration
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.state import TrainingState
from tests.adapters.trained import batch_of, build, saved, sequences

CONFIGURATION = DartConfiguration()


@pytest.fixture(scope="module")
def data() -> SequenceDataset:
    return sequences()


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return batch_of(data, 4)


def _steps(module: DartTraining, batch: MotionBatch, step: int) -> set[str]:
    """The parameters that one step of Muon and AdamW has changed."""
    state = TrainingState.start(module, OptimisationConfiguration(steps=100, optimiser="muon", learning_rate=0.01))
    before = {name: parameter.detach().clone() for name, parameter in module.named_parameters()}
    module.zero_grad()
    module(batch, step)["loss"].backward()
    for optimiser in state.optimisers:
        optimiser.step()
    return {name for name, parameter in module.named_parameters() if not torch.equal(parameter, before[name])}


def test_windows_are_cut_out_where_they_are_asked_for(batch):
    rows, starts = torch.tensor([2, 0]), torch.tensor([0, 5])
    cut = window(batch, rows, starts, 2, CONFIGURATION)
    own = Frames.of_joints(torch.stack((batch.previous_joints, batch.joints[:, 0], batch.joints[:, 1]), dim=1))
    first = cut.primitive(0, 8)
    assert first.joints.shape == (2, 10, 22, 3)
    steps = first.joints_delta[0, :2].norm(dim=-1)  # lengths do not depend on the frame of reference
    torch.testing.assert_close(steps, own.joints_delta[2].norm(dim=-1), rtol=0, atol=1e-5)
    later = (batch.joints[0, 13] - batch.joints[0, 12]).norm(dim=-1)  # frame 5 + 8 is the motion's 12th
    torch.testing.assert_close(cut.primitive(1, 8).joints_delta[1, 0].norm(dim=-1), later, rtol=0, atol=1e-5)


def test_primitives_that_reach_over_the_end_are_marked(batch):
    """Frames 0 to n; a primitive that starts at s needs those up to s + 10."""
    n = int(batch.n_frames[1])
    for start, expected in ((n - 18, [True, True]), (n - 17, [True, False]), (n - 9, [False, False])):
        cut = window(batch, torch.tensor([1]), torch.tensor([start]), 2, CONFIGURATION)
        assert cut.valid[0].tolist() == expected
        assert torch.isfinite(cut.frames.pack()).all()


def test_starts_are_drawn_from_all_that_fit():
    drawn = drawn_starts(torch.tensor([20, 10] * 500), 2, CONFIGURATION, torch.Generator().manual_seed(0))
    assert set(drawn[::2].tolist()) == {0, 1, 2}  # frames 0 to 20, of which a window takes 19
    assert set(drawn[1::2].tolist()) == {0}


def test_statistics_are_those_of_all_primitives(data):
    module = build("dart", data)
    frames = [each.pack().flatten(0, 1) for each in primitives_of(data, range(len(data)), CONFIGURATION)]
    everything = torch.cat(frames).double()
    torch.testing.assert_close(module.mean, everything.mean(dim=0).float())
    std = everything.std(dim=0, correction=0).float()
    varied = std > 0.02
    torch.testing.assert_close(module.std[varied], std[varied], rtol=1e-3, atol=1e-5)
    assert module.std.min() >= 0.001
    assert module.std[:135].min() >= 0.01


def test_what_is_recorded_has_no_body_and_no_delta_loss(batch):
    whole = window(batch, torch.arange(4), torch.zeros(4, dtype=torch.long), 1, CONFIGURATION).primitive(0, 8)
    history, future = whole.part(0, 2), whole.part(2, 10)
    rigid = dataclasses.replace(future, joints=future.joints[:, :1].expand_as(future.joints))
    rigid = dataclasses.replace(
        rigid,
        translation=future.translation[:, :1].expand_as(future.translation),
        orientation=future.orientation[:, :1].expand_as(future.orientation),
        body=future.body[:, :1].expand_as(future.body),
    )
    for loss in body_losses(rigid, rigid, rest_offsets(rigid.joints[:, 0])):
        assert loss.max() < 1e-8
    assert delta_loss(future, history).max() < 1e-8
    moved = dataclasses.replace(future, joints=future.joints + 0.1)
    assert delta_loss(moved, history).min() > 1e-5  # it no longer begins where the history ends
    assert body_losses(moved, future, rest_offsets(future.joints[:, 0]))[1].min() > 1e-3


def test_divergence_worked_by_hand():
    mean, log_variance = torch.tensor([[[2.0, 0.0]]]), torch.tensor([[[0.0, 1.0]]])
    assert divergence(mean, log_variance).item() == pytest.approx((4 + np.e - 2) / 4)


def test_fine_tuning_may_keep_the_vae_with_its_latents_and_otherwise_measures_them_anew(data, batch, tmp_path):
    before = build("dart", data, seed=1)
    before(batch, 50)
    path = saved(before, tmp_path / "before.safetensors")
    after = build("dart", data, initial=path, vae_share=0.0, seed=2)
    assert torch.equal(after.latent_std, before.latent_std)
    assert not after.moment(0)[0]
    assert build("dart", data, initial=path).latent_std.item() == 0


@pytest.mark.parametrize(("progress", "expected"), [(0.0, 0), (0.49, 0), (0.5, 0), (0.625, 0.5), (0.75, 1), (0.99, 1)])
def test_own_predictions_are_fed_back_ever_more_often(progress, expected):
    assert feedback(progress, (0.5, 0.25, 0.25)) == pytest.approx(expected)


def test_the_learning_rate_falls_to_zero_in_each_phase(data):
    module = build("dart", data)
    rates = [module.learning_rate_factor(step) for step in (0, 25, 49, 50, 75, 99)]
    assert rates == pytest.approx([1.0, 0.5, 0.02, 1.0, 0.5, 0.02])


@pytest.mark.parametrize(("step", "trained"), [(0, "vae"), (49, "vae"), (50, "denoiser"), (99, "denoiser")])
def test_each_phase_trains_one_network_alone(data, batch, step, trained):
    module = build("dart", data)
    module(batch, step)["loss"].backward()
    for name, parameter in module.named_parameters():
        moved = parameter.grad is not None and bool(parameter.grad.abs().max() > 0)
        assert not moved or name.startswith(trained), name
        assert parameter.grad is None or torch.isfinite(parameter.grad).all()
        assert parameter.requires_grad  # or checkpoints would leave it out
    assert any(parameter.grad is not None for parameter in getattr(module, trained).parameters())


def test_latents_are_measured_when_the_denoisers_turn_comes(data, batch):
    module = build("dart", data)
    module(batch, 49)
    assert module.latent_std.item() == 0
    module(batch, 50)
    latents = []
    for frames in primitives_of(data, range(len(data)), module.configuration):
        features = (frames.pack() - module.mean) / module.std
        latents.append(module.vae.encode(features[:, :2], features[:, 2:])[0])
    assert module.latent_std.item() == pytest.approx(torch.cat(latents).std().item(), rel=1e-4)


def test_validation_stays_with_recorded_histories_and_the_present_phase(data, batch):
    module = build("dart", data).eval()
    assert module(batch, -1)["latent"].item() == 0
    module.train()(batch, 99)
    assert module.eval()(batch, -1)["latent"].item() > 0
    assert module.moment(-1)[2] == 0


def test_muon_moves_the_layers_of_the_network_whose_turn_it_is(data, batch):
    module = build("dart", data)
    named = {id(parameter): name for name, parameter in module.named_parameters()}
    matrices = {named[id(matrix)] for matrix in module.hidden_matrices()}
    assert any(name.startswith("vae.") for name in matrices)
    assert any(name.startswith("denoiser.") for name in matrices)
    for step, turn in ((0, "vae."), (80, "denoiser.")):
        changed = _steps(module, batch, step)
        assert {name.split(".")[0] + "." for name in changed} == {turn}
        assert {name for name in matrices if name.startswith(turn)} <= changed
