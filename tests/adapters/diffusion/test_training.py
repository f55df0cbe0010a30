"""Training of denoisers: draws, conditions, the start of fine-tuning, and what a step may not see."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.errors import InputFileError, TableError, UsageError
from prbench.geometry.skeleton import Joint
from prbench.representation.features import Statistics
from prbench.representation.tensors import decode
from prbench_adapters import mdm, pr
from prbench_adapters.diffusion.tasks import DiffusionTask
from prbench_adapters.diffusion.training import DiffusionTraining, Objective, losses
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from tests.fakes import fake_dataset

TINY = {
    "width": 16,
    "heads": 2,
    "layers": 2,
    "feed_forward": 32,
    "dropout": 0.0,
    "text_encoder": "hashed-ngrams",
    "text_dimension": 64,
    "diffusion_steps": 10,
}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SequenceDataset:
    folder = tmp_path_factory.mktemp("training")
    return SequenceDataset([fake_dataset(folder / "table", n=24)], cache=folder / "cache")


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return collate([data[index] for index in range(6)])


def _build(
    task: DiffusionTask,
    data: SequenceDataset,
    *,
    stage: str = "finetune",
    initial: Path | None = None,
    seed: int = 0,
    **model: object,
) -> DiffusionTraining:
    torch.manual_seed(seed)
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    return task.build({**TINY, **model}, data=given, initial=initial, stage=stage)


def _saved(module: DiffusionTraining, path: Path) -> Path:
    tensors, metadata = module.weights()
    write_weights(path, tensors, metadata, {})
    return path


@pytest.fixture(scope="module")
def pretrained(data: SequenceDataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[DiffusionTraining, Path]:
    """A text model with other statistics than those of the data, as if it had learnt from a corpus."""
    module = _build(mdm.training_task(), data, stage="pretrain", seed=1)
    module.mean += 0.25
    module.std *= 1.5
    return module, _saved(module, tmp_path_factory.mktemp("weights") / "prior.safetensors")


def _output(module: DiffusionTraining, batch: MotionBatch) -> torch.Tensor:
    module.eval()
    draw = module.draw(batch, 3)
    condition = module.condition(batch, draw.without_text)
    with torch.no_grad():
        return module.denoiser(draw.noise, draw.step, condition, batch.n_frames)


@pytest.mark.parametrize("injection", ["addition", "cross-attention"])
@pytest.mark.parametrize("goal", ["location", "pose"])
def test_fine_tuning_starts_at_the_output_of_the_pretrained_model(data, batch, pretrained, goal, injection):
    before, weights = pretrained
    after = _build(pr.training_task(), data, initial=weights, goal=goal, injection=injection, seed=2)
    assert torch.allclose(_output(before, batch), _output(after, batch), atol=1e-6)


def test_fine_tuning_keeps_the_statistics_of_the_pretrained_model(data, pretrained):
    before, weights = pretrained
    after = _build(pr.training_task(), data, initial=weights, goal="location")
    assert torch.equal(after.mean, before.mean)
    assert torch.equal(after.std, before.std)
    assert after.scaling is not None
    mean, _ = data.condition_statistics("location")
    assert np.array_equal(after.scaling.mean.numpy(), mean)


def test_without_pretraining_statistics_are_those_of_the_data(data):
    module = _build(pr.training_task(), data, goal="location")
    own = data.statistics()
    assert isinstance(own, Statistics)
    assert np.array_equal(module.mean.numpy(), own.mean)
    assert np.array_equal(module.std.numpy(), own.std)


def test_further_fine_tuning_keeps_condition_statistics_too(data, tmp_path):
    first = _build(pr.training_task(), data, goal="location")
    assert first.scaling is not None
    first.scaling.mean.add_(0.5)
    second = _build(pr.training_task(), data, goal="location", initial=_saved(first, tmp_path / "first.safetensors"))
    assert second.scaling is not None
    assert torch.equal(second.scaling.mean, first.scaling.mean)


def test_people_with_bones_of_their_own_are_no_uniform_skeleton(data):
    with pytest.raises(UsageError, match=r"model.uniform_skeleton: .* HumanML3D"):
        _build(pr.training_task(), data, goal="location", uniform_skeleton=True)


def test_draws_depend_on_seed_step_and_rank_alone(data, batch):
    module, other = _build(mdm.training_task(), data), _build(mdm.training_task(), data, seed=5)
    for name in ("step", "without_text", "noise"):
        assert torch.equal(getattr(module.draw(batch, 7), name), getattr(other.draw(batch, 7), name))
    other.rank = 1
    assert not torch.equal(module.draw(batch, 7).noise, other.draw(batch, 7).noise)
    assert not torch.equal(module.draw(batch, 7).noise, module.draw(batch, 8).noise)


def test_text_is_hidden_as_often_as_asked_and_the_vector_never(data, batch):
    module = _build(pr.training_task(), data, goal="location", text_drop=0.3)
    many = torch.cat([module.draw(batch, step).without_text for step in range(300)])
    assert float(many.float().mean()) == pytest.approx(0.3, abs=0.05)
    hidden = module.condition(batch, torch.ones(len(batch), dtype=torch.bool))
    shown = module.condition(batch, torch.zeros(len(batch), dtype=torch.bool))
    assert float(hidden.text.abs().max()) == 0.0
    assert float(shown.text.abs().max()) > 0.0
    assert torch.equal(hidden.padding, shown.padding)
    assert hidden.vector is not None
    assert shown.vector is not None
    assert torch.equal(hidden.vector, shown.vector)


def test_the_noisiest_steps_get_the_share_that_is_asked_for(data, batch):
    """T = 10: the noisiest sixth, rounded up, are two steps, of which a uniform draw takes a fifth."""
    module, more = _build(mdm.training_task(), data), _build(mdm.training_task(), data, noisiest_share=0.5)
    shares = [
        float(torch.cat([trained.draw(batch, step).step for step in range(300)]).ge(8).float().mean())
        for trained in (module, more)
    ]
    assert shares == pytest.approx([0.2, 0.5 + 0.5 * 0.2], abs=0.04)


def test_conditions_know_nothing_of_the_frames_in_between(data, batch):
    """The firewall of training: what the network is told may not change with the motion that it shall find."""
    module = _build(pr.training_task(), data, goal="location")
    shown = torch.zeros(len(batch), dtype=torch.bool)
    between = batch.joints.clone()
    between[:, 1:-1] += 1.0
    changed = dataclasses.replace(batch, joints=between, features=batch.features + 1.0)
    first, second = module.condition(batch, shown).vector, module.condition(changed, shown).vector
    assert first is not None
    assert second is not None
    assert torch.equal(first, second)


@pytest.mark.parametrize("goal", ["location", "pose"])
def test_the_standardised_vector_of_the_training_data_has_mean_0(data, goal):
    module = _build(pr.training_task(), data, goal=goal)
    everything = collate([data[index] for index in range(len(data))])
    vector = module.condition(everything, torch.zeros(len(data), dtype=torch.bool)).vector
    assert vector is not None
    assert torch.allclose(vector.mean(dim=0), torch.zeros(vector.shape[1]), atol=1e-4)


def test_padding_changes_no_loss(data):
    short, long = (collate([data[int(index)]]) for index in np.argsort(data.lengths)[[0, -1]])
    module = _build(mdm.training_task(), data)
    extra = long.features.shape[1] - short.features.shape[1]
    assert extra > 0
    padded = dataclasses.replace(
        short,
        features=torch.nn.functional.pad(short.features, (0, 0, 0, extra), value=9.0),
        joints=torch.nn.functional.pad(short.joints, (0, 0, 0, 0, 0, extra), value=9.0),
        padding=torch.nn.functional.pad(short.padding, (0, extra), value=True),
    )
    drawn = module.draw(padded, 0)
    module.draw = lambda batch, step: dataclasses.replace(drawn, noise=drawn.noise[:, : batch.features.shape[1]])
    first, second = module(short, 0), module(padded, 0)
    for name in first:
        assert float(first[name].detach()) == pytest.approx(float(second[name].detach()), rel=1e-5)


def test_every_weight_learns_and_the_loss_of_one_batch_falls(data, batch):
    module = _build(pr.training_task(), data, goal="location", text_drop=0.0)
    optimiser = torch.optim.AdamW(module.parameters(), lr=5e-3)
    first = module(batch, 0)
    first["loss"].backward()
    still = [name for name, parameter in module.named_parameters() if parameter.grad is None]
    assert not still
    for _ in range(60):
        optimiser.zero_grad()
        loss = module(batch, 0)["loss"]
        loss.backward()
        optimiser.step()
    assert float(loss.detach()) < 0.6 * float(first["loss"].detach())


def test_the_true_motion_has_no_loss(data, batch):
    module = _build(mdm.training_task(), data)
    clean = (batch.features - module.mean) / module.std
    module.denoiser.forward = lambda *given: clean
    found = module(dataclasses.replace(batch, joints=decode(batch.features)), 0)
    assert {name: float(loss) for name, loss in found.items()} == pytest.approx(dict.fromkeys(found, 0.0), abs=1e-7)


@pytest.mark.parametrize(
    ("task", "stage", "model", "message"),
    [
        (mdm.training_task(), "finetune", {"goal": "location"}, "--method mdm .* expected model.goal to be none"),
        (pr.training_task(), "finetune", {"goal": "none"}, "expected model.goal to be pose or location, found 'none'"),
        (pr.training_task(), "finetune", {"goal": "location", "widht": 32}, "unknown field `widht`"),
        (mdm.training_task(), "pretrain", {"text_dimension": 768}, "vectors of 64 numbers, found 768"),
        (mdm.training_task(), "pretrain", {"representation": "reference"}, "data.mode: the model expects reference"),
        (mdm.training_task(), "pretrain", {"max_frames": 100}, "expected at most the model's 100, found 241"),
        (mdm.training_task(), "pretrain", {"fps": 30.0}, "the model expects 30.0, found 20.0"),
    ],
)
def test_what_does_not_fit_together_is_refused(data, task, stage, model, message):
    with pytest.raises(UsageError, match=message):
        _build(task, data, stage=stage, **model)


def test_initial_weights_of_another_size_are_refused_with_the_key_to_change(data, pretrained):
    with pytest.raises(InputFileError, match=r"configuration\.width: expected 32.* --set model\.width=16"):
        _build(pr.training_task(), data, initial=pretrained[1], goal="location", width=32)


def test_initial_weights_for_the_other_goal_are_refused(data, tmp_path):
    weights = _saved(_build(pr.training_task(), data, goal="pose"), tmp_path / "pose.safetensors")
    with pytest.raises(InputFileError, match=r"configuration\.goal: expected location.*found pose"):
        _build(pr.training_task(), data, initial=weights, goal="location")


def test_goal_locations_are_asked_of_the_data(data):
    class WithoutGoals(SequenceDataset):
        def __init__(self) -> None:
            self.__dict__ |= data.__dict__

        def condition_statistics(self, goal: str):  # as a corpus answers
            raise TableError("no goal location")

    with pytest.raises(TableError, match="no goal location"):
        _build(pr.training_task(), WithoutGoals(), goal="location")


def _zeros(frames: int = 4, batch: int = 1) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    return torch.zeros(batch, frames, 263), torch.zeros(batch, frames, 22, 3), torch.zeros(batch, frames).bool()


def test_both_sums_share_one_divisor():
    features, joints, padding = _zeros()
    predicted, moved = features.clone(), joints.clone()
    predicted[0, 1, 7] = 3.0  # 9 in one of 4 x 263 entries
    moved[0, 2, 5] = torch.tensor([2.0, 0.0, 0.0])  # 4 square metres
    found = losses(Objective(), predicted, features, moved, joints, padding)
    assert float(found["features"]) == pytest.approx(9 / (263 * 4))
    assert float(found["joints"]) == pytest.approx(4 / (263 * 4))
    assert float(found["loss"]) == pytest.approx(13 / (263 * 4))


def test_weights_choose_the_parts():
    features, joints, padding = _zeros()
    moved = joints.clone()
    moved[0, 2, 5, 0] = 2.0  # the displacement errs by 2 m into this frame and by 2 m out of it
    found = losses(
        Objective(joint_loss_weight=0.0, velocity_loss_weight=10.0), features, features, moved, joints, padding
    )
    assert float(found["velocities"]) == pytest.approx(8 / (263 * 4))
    assert float(found["loss"]) == pytest.approx(80 / (263 * 4))


def test_a_body_moved_as_a_whole_has_no_bone_loss_and_a_stretched_one_has():
    features, joints, padding = _zeros()
    stretched = joints.clone()
    stretched[0, 2, Joint.RIGHT_WRIST, 1] = 0.5  # one bone, half a metre too long, in one of four frames
    weights = Objective(joint_loss_weight=0.0, bone_loss_weight=2.0)
    assert float(losses(weights, features, features, joints + 1.0, joints, padding)["loss"]) == pytest.approx(0.0)
    found = losses(weights, features, features, stretched, joints, padding)
    assert float(found["bones"]) == pytest.approx(0.25 / (263 * 4))
    assert float(found["loss"]) == pytest.approx(0.5 / (263 * 4))


def test_whatever_stands_in_padding_leaves_no_trace():
    features, joints, padding = _zeros(6)
    padding[:, 4:] = True
    predicted = torch.full((1, 6, 263), 1.0)
    wild = predicted.clone()
    wild[:, 4:] = 1e6
    flying = joints.clone()
    flying[:, 4:] = 1e6
    plain = losses(Objective(velocity_loss_weight=1.0), predicted, features, joints, joints, padding)
    padded = losses(Objective(velocity_loss_weight=1.0), wild, features, flying, joints, padding)
    assert all(torch.equal(plain[name], padded[name]) for name in plain)
    assert float(plain["features"]) == pytest.approx(1.0)


def test_long_sequences_count_more():
    features, joints, padding = _zeros(4, batch=2)
    padding[1, 1:] = True  # one frame against four
    predicted = features.clone()
    predicted[1, 0] = 1.0
    by_frames = losses(Objective(), predicted, features, joints, joints, padding)
    assert float(by_frames["features"]) == pytest.approx(1 / 5)
