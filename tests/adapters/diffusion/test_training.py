"""Training of denoisers: draws, conditions, the start of fine-tuning, and losses worked by hand."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.errors import TableError
from prbench.geometry.skeleton import Joint
from prbench.representation.features import Statistics
from prbench.representation.tensors import decode
from prbench_adapters.diffusion.training import DiffusionTraining, Objective, foot_loss, losses, ray_loss, wrist_loss
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.dataset import MotionBatch
from tests.adapters.trained import batch_of, build, saved, sequences
from tests.adapters.training.tables import corpus_table
from tests.fakes import STANDING


@pytest.fixture(scope="module")
def data() -> SequenceDataset:
    return sequences()


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return batch_of(data)


@pytest.fixture(scope="module")
def pretrained(data: SequenceDataset, tmp_path_factory: pytest.TempPathFactory) -> tuple[DiffusionTraining, Path]:
    """A text model with other statistics than those of the data, as if it had learnt from a corpus."""
    module = build("mdm", data, stage="pretrain", seed=1)
    module.mean += 0.25
    module.std *= 1.5
    return module, saved(module, tmp_path_factory.mktemp("weights") / "prior.safetensors")


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
    after = build("pr", data, initial=weights, goal=goal, injection=injection, seed=2)
    assert torch.allclose(_output(before, batch), _output(after, batch), atol=1e-6)
    assert torch.equal(after.mean, before.mean)
    assert torch.equal(after.std, before.std)
    assert np.array_equal(after.scaling.mean.numpy(), data.condition_statistics(goal)[0])


def test_text_is_hidden_as_often_as_asked_and_the_vector_never(data, batch):
    module = build("pr", data, text_drop=0.3)
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
    module, more = build("mdm", data), build("mdm", data, noisiest_share=0.5)
    shares = [
        float(torch.cat([trained.draw(batch, step).step for step in range(300)]).ge(8).float().mean())
        for trained in (module, more)
    ]
    assert shares == pytest.approx([0.2, 0.5 + 0.5 * 0.2], abs=0.04)


def test_with_a_floor_little_noise_weighs_more(data, batch):
    """A miss weighs 1 / (share of noise + floor) beside one without a floor."""
    plain, module = (build("pr-frames", data, noise_floor=floor) for floor in (0.0, 0.05))
    clean = plain.standardised(batch, plain.condition(batch, plain.draw(batch, 0).without_text))
    for step in (0, len(plain.noise) - 1):
        found = []
        for trained in (plain, module):
            drawn = dataclasses.replace(trained.draw(batch, 0), step=torch.full((len(batch),), step))
            trained.draw = lambda *_, drawn=drawn: drawn
            trained.denoiser.forward = lambda *_: clean + 0.3
            found.append({name: float(loss) for name, loss in trained(batch, 0).items()})
        share = 1 / (float(plain.noise[step]) ** 2 + 0.05)
        assert found[1] == pytest.approx({name: share * loss for name, loss in found[0].items()}, rel=1e-4)


def test_a_negative_weight_is_refused_by_name():
    with pytest.raises(ValueError, match="'noise_floor'"):
        Objective(noise_floor=-0.1)


@pytest.mark.parametrize("name", ["pr", "pr-frames"])
def test_conditions_know_nothing_of_the_frames_in_between(name, data, batch):
    """The firewall of training: what the network is told may not change with the motion that it shall find."""
    module = build(name, data)
    shown = torch.zeros(len(batch), dtype=torch.bool)
    between = batch.joints.clone()
    between[:, 1:-1] += 1.0
    changed = dataclasses.replace(batch, joints=between, features=batch.features + 1.0)
    first, second = module.condition(batch, shown).vector, module.condition(changed, shown).vector
    assert first is not None
    assert second is not None
    assert torch.equal(first, second)


@pytest.mark.parametrize("goal", ["location", "pose"])
def test_without_pretraining_statistics_are_those_of_the_data_and_conditions_have_mean_0(data, goal):
    module, own = build("pr", data, goal=goal), data.statistics()
    assert isinstance(own, Statistics)
    assert np.array_equal(module.mean.numpy(), own.mean)
    assert np.array_equal(module.std.numpy(), own.std)
    everything = collate([data[index] for index in range(len(data))])
    vector = module.condition(everything, torch.zeros(len(data), dtype=torch.bool)).vector
    assert vector is not None
    assert torch.allclose(vector.mean(dim=0), torch.zeros(vector.shape[1]), atol=1e-4)


def test_padding_changes_no_loss(data):
    short, long = (collate([data[int(index)]]) for index in np.argsort(data.lengths)[[0, -1]])
    module = build("mdm", data)
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


def test_the_true_motion_has_no_loss(data, batch):
    module = build("mdm", data)
    clean = (batch.features - module.mean) / module.std
    module.denoiser.forward = lambda *given: clean
    found = module(dataclasses.replace(batch, joints=decode(batch.features)), 0)
    assert {name: float(loss) for name, loss in found.items()} == pytest.approx(dict.fromkeys(found, 0.0), abs=1e-7)


def test_goal_locations_are_asked_of_the_data(tmp_path):
    with pytest.raises(TableError, match="expected a goal location"):
        build("pr", SequenceDataset(corpus_table(tmp_path / "corpus"), cache=tmp_path / "cache"))


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


RATE = 20.0
JOINTS = torch.from_numpy(STANDING).float().expand(1, 8, 22, 3)
VALID = torch.ones(1, 8, dtype=torch.bool)
PRIME = torch.arange(8) / RATE


def _nodding() -> torch.Tensor:
    """The neck-head bone of frame 0 level instead of upright."""
    nodded = JOINTS.clone()
    length = (JOINTS[0, 0, Joint.HEAD] - JOINTS[0, 0, Joint.NECK]).norm()
    nodded[0, 0, Joint.HEAD] = nodded[0, 0, Joint.NECK] + length * torch.tensor([0.0, 0.0, 1.0])
    return nodded


def test_the_recorded_motion_has_no_loss():
    goal = torch.tensor([[0.0, 1.0, 2.0]])
    assert float(ray_loss(JOINTS, JOINTS, goal, VALID, PRIME)) == 0.0
    assert float(foot_loss(JOINTS, JOINTS, VALID, RATE)) == 0.0
    assert float(wrist_loss(JOINTS, JOINTS, VALID, torch.tensor([8]), RATE)) == 0.0


def test_a_miss_counts_by_the_distance_of_the_goal_and_most_of_all_at_prime_time():
    near = torch.tensor([[0.0, 1.6, 1.0]])
    far = torch.tensor([[0.0, 1.6, 2.0]])
    at_prime = ray_loss(_nodding(), JOINTS, near, VALID, PRIME)
    ratio = float(ray_loss(_nodding(), JOINTS, far, VALID, PRIME) / at_prime)
    assert 3.0 < ratio < 5.0, "four times the square metres at twice the distance, about"
    assert float(ray_loss(_nodding(), JOINTS, near, VALID, PRIME + 2.0)) < float(at_prime)
    assert float(ray_loss(_nodding(), JOINTS, torch.full((1, 3), torch.nan), VALID, PRIME)) == 0.0, "no goal"


def test_a_foot_that_slides_where_the_recorded_one_is_planted_has_a_loss():
    slid = JOINTS.clone()
    slid[0, 4:, Joint.LEFT_FOOT, 0] += 0.1  # one step of one foot in 7 x 2
    assert float(foot_loss(slid, JOINTS, VALID, RATE)) == pytest.approx(0.01 / 14)
    assert float(foot_loss(slid, slid, VALID, RATE)) == pytest.approx(0.0), "there nobody stands"


def test_wrists_count_at_the_end_alone():
    early = JOINTS.clone()
    early[0, 0, Joint.LEFT_WRIST] += 1.0
    late = JOINTS.clone()
    late[0, -1, Joint.LEFT_WRIST, 1] += 0.6  # of six frames and two wrists
    lengths = torch.tensor([8])
    assert float(wrist_loss(early, JOINTS, VALID, lengths, RATE)) == 0.0
    assert float(wrist_loss(late, JOINTS, VALID, lengths, RATE)) == pytest.approx(0.36 / 12)
