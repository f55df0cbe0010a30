"""Training of DART: windows, phases, and what each loss is zero for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.geometry.skeleton import TOES, Joint
from prbench.protocol.manifests import load_protocol
from prbench_adapters.dart import training
from prbench_adapters.dart.model import DartConfiguration, FeatureScaling, Frames
from prbench_adapters.dart.training import (
    DartTraining,
    Window,
    body_losses,
    delta_loss,
    divergence,
    drawn_starts,
    feedback,
    primitives_of,
    scored_losses,
    window,
)
from prbench_adapters.kinematics import DART, fitted_rotations, forward_kinematics, rest_offsets
from prbench_adapters.training import SequenceDataset
from prbench_adapters.training.configuration import OptimisationConfiguration
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.state import TrainingState
from tests.adapters.trained import batch_of, build, saved, sequences
from tests.fakes import STANDING

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


def _standing(start: int, *, goal: float = 1.0) -> tuple[Window, torch.Tensor]:
    """A window of two primitives of a body that stands still, and the same as a network would show it."""
    body = torch.as_tensor(STANDING, dtype=torch.float32)
    frames = Frames.of_joints(DART.from_y_up(body).expand(1, 19, 22, 3))
    location = (body[Joint.HEAD] + torch.tensor([0.0, 0.0, goal]))[None]
    cut = Window(frames, torch.ones(1, 2, dtype=torch.bool), torch.tensor([start]), location)
    return cut, body.expand(1, 2, 9, 22, 3)


@pytest.mark.parametrize("start", [0, 17, 40])
def test_a_missed_ray_counts_by_the_time_of_its_frame_in_the_sequence(start):
    """One frame's head hangs upside down: both of its axes are opposite to the recorded ones, a metre from the goal."""
    cut, recorded = _standing(start)
    lead = load_protocol().curation.lead
    assert float(scored_losses(recorded, cut, 20.0)["ray"]) == 0.0
    # The fourth frame that the second primitive adds; behind the history of 2 frames each adds 8.
    turned = recorded.clone()
    turned[:, 1, 4, Joint.HEAD] = 2 * turned[:, 1, 4, Joint.NECK] - turned[:, 1, 4, Joint.HEAD]
    seconds = (start + 2 + np.arange(16) - 1) / 20.0 - lead
    weights = 0.2 + np.exp(-((seconds / 0.75) ** 2))
    expected = weights[8 + 3] * (2.0**2 + 2.0**2) / weights.sum()
    assert float(scored_losses(turned, cut, 20.0)["ray"]) == pytest.approx(expected, rel=1e-4)
    # The last frame of the history is given: nothing that a network predicts.
    given = recorded.clone()
    given[:, :, 0, Joint.HEAD] += 0.1
    assert float(scored_losses(given, cut, 20.0)["ray"]) == 0.0


def test_primitives_behind_the_end_and_motions_without_a_goal_miss_no_ray():
    cut, recorded = _standing(17)
    nodding = recorded.clone()
    nodding[:, 1, :, Joint.HEAD, 2] += 0.1
    assert float(scored_losses(nodding, cut, 20.0)["ray"]) > 0.0
    outside = dataclasses.replace(cut, valid=torch.tensor([[True, False]]))
    assert float(scored_losses(nodding, outside, 20.0)["ray"]) == 0.0
    without = dataclasses.replace(cut, goal=torch.full((1, 3), torch.nan))
    assert float(scored_losses(nodding, without, 20.0)["ray"]) == 0.0
    # Nor do they thin out what the others miss.
    twice = cut.frames.each(lambda values: values.expand(2, *values.shape[1:]))
    both = Window(twice, cut.valid.expand(2, 2), cut.start.expand(2), torch.cat((cut.goal, without.goal)))
    missed = scored_losses(nodding.expand(2, 2, 9, 22, 3), both, 20.0)["ray"]
    assert torch.allclose(missed, scored_losses(nodding, cut, 20.0)["ray"])


def test_planted_toes_are_to_stay_from_the_end_of_the_history_on():
    cut, recorded = _standing(0)
    sliding = recorded.clone()
    sliding[:, 0, 1:, TOES[0], 0] += 0.02  # a single step, out of the first primitive's history
    # 2 primitives with 8 steps of 2 toes each.
    assert float(scored_losses(sliding, cut, 20.0)["feet"]) == pytest.approx(0.02**2 / 32, rel=1e-4)


@pytest.mark.parametrize("step", [0, 40, 50, 90])
def test_rays_and_feet_weigh_in_both_phases_and_otherwise_are_not_there(data, batch, step):
    plain = build("dart", data)(batch, step)
    module = build("dart", data, ray_loss_weight=2.0, foot_loss_weight=5.0)
    found = module(batch, step)
    assert set(found) - set(plain) == {"ray", "feet"}
    parts = plain["loss"] + 2.0 * found["ray"] + 5.0 * found["feet"]
    assert torch.allclose(found["loss"], parts, rtol=1e-5)
    assert float(found["ray"]) > 0
    only = build("dart", data, ray_loss_weight=2.0)(batch, step)
    assert set(only) - set(plain) == {"ray"}


def test_bodies_that_are_judged_stand_in_the_motions_world(data, batch, monkeypatch):
    """A decoder that gives what was recorded shows the recorded bodies, if those have constant bones."""
    module = build("dart", data, ray_loss_weight=1.0, primitives=3)
    motions = torch.cat((batch.previous_joints[:, None], batch.joints), dim=1)
    offsets = rest_offsets(motions[:, 0])[:, None]
    rigid = forward_kinematics(fitted_rotations(motions), motions[:, :, Joint.PELVIS], offsets)
    rigid_batch = dataclasses.replace(batch, previous_joints=rigid[:, 0], joints=rigid[:, 1:])
    starts = torch.tensor([0, 3, 7, 1])
    cut = window(rigid_batch, torch.arange(4), starts, 3, CONFIGURATION)
    scaling = FeatureScaling(module.mean, module.std)
    futures = iter([scaling.standardised(cut.primitive(number, 8))[:, 2:] for number in range(3)])
    judged = []
    monkeypatch.setattr(module.vae, "decode", lambda latent, history: next(futures))
    monkeypatch.setattr(training, "scored_losses", lambda shown, *_: judged.append(shown) or {"ray": shown.sum()})
    module._losses(cut, None, 0.0, torch.Generator())
    for row, start in enumerate(starts.tolist()):
        for number in range(3):
            first = start + 8 * number + 1  # the last frame of the history
            assert torch.allclose(judged[0][row, number], rigid[row, first : first + 9], atol=1e-5)


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
