"""Training of DART: phases, windows, what each loss is zero for, and that both networks learn."""

from __future__ import annotations

import dataclasses
import json
import signal
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.cli import main
from prbench.contract import Condition
from prbench.errors import InputFileError, TrainingStopped, UsageError
from prbench.files.storage import read_json
from prbench.harness.methods.loading import load_adapter
from prbench_adapters.dart.model import DartConfiguration, Frames
from prbench_adapters.dart.training import (
    DartTask,
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
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.configuration import OptimisationConfiguration, TrainingConfiguration
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.loop import fit
from prbench_adapters.training.state import TrainingState
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from tests.adapters.dart.tiny import SIZES
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import fake_dataset

MODEL = {**SIZES, "diffusion_steps": 2, "vae_share": 0.5, "primitives": 2}
CONFIGURATION = DartConfiguration()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dart-training")
    fake_dataset(folder / "table", n=24)
    return folder


@pytest.fixture(scope="module")
def data(folder: Path) -> SequenceDataset:
    return SequenceDataset([folder / "table"], cache=folder / "cache")


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return collate([data[index] for index in range(4)])


def _build(data: SequenceDataset, *, initial: Path | None = None, seed: int = 0, **model: object) -> DartTraining:
    torch.manual_seed(seed)
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    module = DartTask().build({**MODEL, **model}, data=given, initial=initial, stage="finetune")
    module.calls = 100
    return module


def _steps(module: DartTraining, batch: MotionBatch, step: int) -> set[str]:
    """The parameters that one step of Muon and AdamW has changed."""
    state = TrainingState.start(module, OptimisationConfiguration(steps=100, optimiser="muon", learning_rate=0.01))
    before = {name: parameter.detach().clone() for name, parameter in module.named_parameters()}
    module.zero_grad()
    module(batch, step)["loss"].backward()
    for optimiser in state.optimisers:
        optimiser.step()
    return {name for name, parameter in module.named_parameters() if not torch.equal(parameter, before[name])}


def _saved(module: DartTraining, path: Path) -> Path:
    tensors, metadata = module.weights()
    write_weights(path, tensors, metadata, {})
    return path


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
    module = _build(data)
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


@pytest.mark.parametrize(("progress", "expected"), [(0.0, 0), (0.49, 0), (0.5, 0), (0.625, 0.5), (0.75, 1), (0.99, 1)])
def test_own_predictions_are_fed_back_ever_more_often(progress, expected):
    assert feedback(progress, (0.5, 0.25, 0.25)) == pytest.approx(expected)


def test_the_learning_rate_falls_to_zero_in_each_phase(data):
    module = _build(data)
    rates = [module.learning_rate_factor(step) for step in (0, 25, 49, 50, 75, 99)]
    assert rates == pytest.approx([1.0, 0.5, 0.02, 1.0, 0.5, 0.02])


@pytest.mark.parametrize(("step", "trained"), [(0, "vae"), (49, "vae"), (50, "denoiser"), (99, "denoiser")])
def test_each_phase_trains_one_network_alone(data, batch, step, trained):
    module = _build(data)
    module(batch, step)["loss"].backward()
    for name, parameter in module.named_parameters():
        moved = parameter.grad is not None and bool(parameter.grad.abs().max() > 0)
        assert not moved or name.startswith(trained), name
        assert parameter.grad is None or torch.isfinite(parameter.grad).all()
        assert parameter.requires_grad  # or checkpoints would leave it out
    assert any(parameter.grad is not None for parameter in getattr(module, trained).parameters())


def test_latents_are_measured_when_the_denoisers_turn_comes(data, batch):
    module = _build(data)
    module(batch, 49)
    assert module.latent_std.item() == 0
    module(batch, 50)
    latents = []
    for frames in primitives_of(data, range(len(data)), module.configuration):
        features = (frames.pack() - module.mean) / module.std
        latents.append(module.vae.encode(features[:, :2], features[:, 2:])[0])
    assert module.latent_std.item() == pytest.approx(torch.cat(latents).std().item(), rel=1e-4)


def test_a_step_is_a_function_of_its_number(data, batch):
    module = _build(data)
    for step in (40, 90):
        first, again, other = (module(batch, number)["loss"] for number in (step, step, step + 1))
        assert torch.equal(first, again)
        assert not torch.equal(first, other)


def test_padding_leaves_no_trace(data, batch):
    module = _build(data)
    valid = ~batch.padding[..., None, None]
    spoilt = dataclasses.replace(batch, joints=torch.where(valid, batch.joints, torch.nan))
    for step in (0, 60):
        assert torch.equal(module(batch, step)["loss"], module(spoilt, step)["loss"])


def test_validation_stays_with_recorded_histories_and_the_present_phase(data, batch):
    module = _build(data).eval()
    assert module(batch, -1)["latent"].item() == 0
    module.train()(batch, 99)
    assert module.eval()(batch, -1)["latent"].item() > 0
    assert module.moment(-1)[2] == 0


def test_both_networks_learn(data):
    """Without the weight of 1e4 on deltas, which these made-up bodies, with bones that change, cannot meet."""
    recorded = {"vae_stages": [1.0, 0.0, 0.0], "denoiser_stages": [1.0, 0.0, 0.0], "primitives": 1}
    module, batch = _build(data, **recorded, denoiser_delta_weight=0.0, text_drop=0.0), collate([data[0]] * 8)
    for first, name in ((0, "reconstruction"), (50, "latent")):
        optimiser, seen = torch.optim.Adam(module.parameters(), lr=5e-3), []
        for step in range(first, first + 30):
            parts = module(batch, step)
            optimiser.zero_grad()
            parts["loss"].backward()
            optimiser.step()
            seen.append(float(parts[name]))
        assert np.mean(seen[-5:]) < 0.85 * np.mean(seen[:5]), name


def test_fine_tuning_keeps_statistics_and_may_keep_the_vae(data, batch, tmp_path):
    before = _build(data, seed=1)
    before(batch, 50)
    before.mean += 0.25
    path = _saved(before, tmp_path / "before.safetensors")
    after = _build(data, initial=path, vae_share=0.0, seed=2)
    assert torch.equal(after.mean, before.mean)
    assert torch.equal(after.latent_std, before.latent_std)
    assert not after.moment(0)[0]
    assert torch.equal(after.vae.decoder_head.weight, before.vae.decoder_head.weight)
    assert "before.safetensors" in after.origin[1]
    assert _build(data, initial=path).latent_std.item() == 0  # measured anew, because the VAE changes
    with pytest.raises(InputFileError, match=r"configuration\.layers: expected 3.*Add --set model\.layers=2"):
        _build(data, initial=path, layers=3)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"windth": 3}, "unknown field"),
        ({"vae_share": 1.0}, "vae_share"),
        ({"vae_share": 0.0}, r"vae_share: 0 keeps the VAE of initial weights"),
        ({"vae_stages": [0.5, 0.5, 0.5]}, "vae_stages"),
        ({"windows": 0}, "windows"),
        ({"text_dimension": 65}, r"text_dimension: .* vectors of 64 numbers"),
        ({"fps": 30.0}, "expects 30, found 20"),
        ({"future_frames": 300}, "a motion primitive takes 302 frames"),
    ],
)
def test_what_does_not_fit_is_refused(model, message, data):
    with pytest.raises(UsageError, match=message):
        _build(data, **model)


@pytest.mark.parametrize("stopped_after", [2, 4])
def test_a_stopped_training_goes_on_to_the_same_bits_in_either_phase(data, tmp_path, monkeypatch, stopped_after):
    settings = OptimisationConfiguration(steps=6, learning_rate=1e-3, ema=0.9, save_every=9, log_every=1)
    configuration = TrainingConfiguration(model={}, training=settings)

    def trained(out: Path, stop: int | None = None) -> bytes:
        def batches(start: int):
            for step in range(start, 6):
                if step + 1 == stop:
                    signal.raise_signal(signal.SIGTERM)
                yield collate([data[step], data[step + 1]])

        fit(_build(data), batches, configuration, out)
        return (out / "weights.safetensors").read_bytes()

    with pytest.raises(TrainingStopped):
        trained(tmp_path / "stopped", stopped_after)
    assert trained(tmp_path / "stopped") == trained(tmp_path / "whole")


def test_the_smoke_configuration_trains_and_its_weights_generate(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    command = ["train", "--method", "dart", "--config", "smoke", "--data", str(folder / "table")]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    card = read_json(tmp_path / "out" / "weights.json")
    assert (card["method"], card["finished"], card["steps"]) == ("dart", True, 6)
    rows = card["learning_curve"]
    assert [row["latent"] > 0 for row in rows] == [False] * 3 + [True] * 3
    assert json.dumps(card["learned_from"]).count("hashed-ngrams") == 1
    adapter = load_adapter("dart", tmp_path / "out", {"iterations": "1"}, "cpu")
    batch = conditions(Condition.GOAL_POSE, 1, frames=(12,))
    assert np.isfinite(adapter.generate(batch, seed=0).joints).all()


def test_muon_moves_the_layers_of_the_network_whose_turn_it_is(data, batch):
    module = _build(data)
    named = {id(parameter): name for name, parameter in module.named_parameters()}
    matrices = {named[id(matrix)] for matrix in module.hidden_matrices()}
    assert any(name.startswith("vae.") for name in matrices)
    assert any(name.startswith("denoiser.") for name in matrices)
    for step, turn in ((0, "vae."), (80, "denoiser.")):
        changed = _steps(module, batch, step)
        assert {name.split(".")[0] + "." for name in changed} == {turn}
        assert {name for name in matrices if name.startswith(turn)} <= changed
