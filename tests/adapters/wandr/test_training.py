"""Training of WANDR: what it learns from, what a step may not see, and that it learns."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.geometry.skeleton import Joint
from prbench.representation import mirror
from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.wandr.training import (
    Places,
    Recordings,
    delta_loss,
    divergence,
    goal_frames,
    joint_loss,
    starts,
)
from tests.adapters.trained import batch_of, build, sequences
from tests.adapters.training.tables import corpus_table
from tests.adapters.wandr.tiny import TINY
from tests.fakes import STANDING


@pytest.fixture(scope="module")
def data() -> SequenceDataset:
    return sequences()


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return batch_of(data)


def _walk(n_frames: int, *, wrist: Joint = Joint.RIGHT_WRIST, goal_known: bool = True) -> MotionBatch:
    """One body that slides along +Z, 10 cm a frame; its goal is where a wrist ends."""
    moved = np.arange(-1, n_frames)[:, None, None] * np.array([0.0, 0.0, 0.1])
    joints = (STANDING + moved).astype(np.float32)
    joints[:, Joint.RIGHT_WRIST, 1] += 0.2  # otherwise it is its own mirror image
    goal = torch.from_numpy(joints[None, -1, wrist]) * (1.0 if goal_known else torch.nan)
    return MotionBatch(
        features=torch.zeros(1, n_frames, 263),
        joints=torch.from_numpy(joints[None, 1:]),
        padding=torch.zeros(1, n_frames, dtype=torch.bool),
        n_frames=torch.tensor([n_frames]),
        text=("walks",),
        initial_joints=torch.from_numpy(joints[None, 1]),
        previous_joints=torch.from_numpy(joints[None, 0]),
        goal_joints=torch.from_numpy(joints[None, -1]),
        goal_location=goal,
        fps=20.0,
        sequence_id=("one",),
    )


def _condition(module, recordings: Recordings, places: Places, goals: torch.Tensor) -> torch.Tensor:
    states, delta = recordings.states(places), recordings.deltas(places.later(-1))
    joints = recordings.joints[places.index]
    return module._condition(recordings, places, goals, states, delta=delta, joints=joints)


@pytest.mark.parametrize("n_frames", [40, 41])
def test_recordings_come_at_the_networks_rate_and_end_on_the_last_frame(n_frames):
    found = Recordings.of(_walk(n_frames), 30.0)
    assert found.n_frames.tolist() == [n_frames * 3 // 2 + 1]
    pelvis = WORLD.to_y_up(found.joints)[0, :, 0, 2]
    assert pelvis[-1] == pytest.approx(0.1 * (n_frames - 1), abs=1e-5)
    assert torch.allclose(pelvis.diff(), torch.tensor(0.1 * 20 / 30), atol=1e-5)


def test_the_same_rate_changes_nothing(batch):
    found = Recordings.of(dataclasses.replace(batch, goal_location=batch.goal_location * torch.nan), 20.0)
    for row, n in enumerate(batch.n_frames):
        kept = WORLD.to_y_up(found.joints[row, : n + 1])
        assert torch.allclose(kept[0], batch.previous_joints[row], atol=1e-5)
        assert torch.allclose(kept[1:], batch.joints[row, :n], atol=1e-5)


def test_left_handed_reaches_are_learnt_from_as_right_handed_ones():
    right, left = (Recordings.of(_walk(30, wrist=wrist), 30.0) for wrist in (Joint.RIGHT_WRIST, Joint.LEFT_WRIST))
    assert torch.allclose(right.joints, Recordings.of(_walk(30, goal_known=False), 30.0).joints)
    seen = mirror(WORLD.to_y_up(right.joints).numpy())
    assert np.allclose(WORLD.to_y_up(left.joints), seen, atol=1e-5)


def test_goals_are_in_the_last_frame_where_there_are_some_and_made_up_elsewhere_or_for_a_share():
    sequence = Recordings.of(_walk(40), 30.0)
    places = starts(sequence, 1)
    generator = torch.Generator().manual_seed(0)
    assert (goal_frames(sequence, places, generator) == 60).all()
    shared = torch.stack([goal_frames(sequence, places, generator, pseudo_share=0.5) for _ in range(200)])
    far = (60 - places.frame) * 0.1 * 20 / 30 >= 1.5
    assert float((shared[:, 0] == 60).float().mean()) == pytest.approx(0.5, abs=0.1)
    assert (shared[:, ~far] == 60).all(), "near the goal nothing is far enough away, and the goal stays"
    clip = dataclasses.replace(sequence, goal=torch.full((1, 3), torch.nan))
    drawn = torch.stack([goal_frames(clip, places, generator) for _ in range(200)])
    walked = (drawn - places.frame) * 0.1 * 20 / 30
    nothing = drawn == places.frame
    assert (nothing == ~far).all()
    assert (walked[~nothing] >= 1.5 - 1e-4).all()
    assert set(drawn[:, 0].tolist()) == set(range(24, 61))  # from the first frame on: 23 frames are 1.53 m


def test_the_head_and_planted_toes_of_chunks_count_where_they_have_a_weight(data, batch):
    recordings = Recordings.of(batch, 30.0)
    module = build("wandr", data, ray_loss_weight=2.0, foot_loss_weight=5.0)
    places = starts(recordings, 6).following(6)
    recorded = recordings.joints[places.index]
    still = module._scored(recordings, places, recorded)
    assert float(still["own_rays"]) == 0.0
    nodding = recorded.clone()
    nodding[:, :, Joint.HEAD, 0] += 0.1
    sliding = recorded + 0.02 * torch.arange(6)[:, None, None]
    assert float(module._scored(recordings, places, nodding)["own_rays"]) > 0
    assert float(module._scored(recordings, places, sliding)["own_feet"]) > float(still["own_feet"]) + 1e-5
    without_goals = dataclasses.replace(recordings, goal=torch.full_like(recordings.goal, torch.nan))
    assert float(module._scored(without_goals, places, nodding)["own_rays"]) == 0.0
    plain = build("wandr", data)(batch, 5)
    losses = module(batch, 5)
    extra = 2.0 * losses["own_rays"] + 5.0 * losses["own_feet"]
    assert set(losses) - set(plain) == {"own_rays", "own_feet"}
    assert float(losses["loss"].detach() - plain["loss"].detach()) == pytest.approx(float(extra), rel=1e-2)


def test_intentions_are_as_limited_in_training_as_in_generation(data, batch):
    recordings = Recordings.of(batch, 30.0)
    places = Places(torch.arange(6), torch.full((6,), 5))
    goals = recordings.n_frames - 1

    def velocity(most_speed):
        return _condition(build("wandr", data, most_speed=most_speed), recordings, places, goals)[:, -9:-6]

    free = velocity(0.0)
    most = float(free.norm(dim=-1).max()) / 2
    assert torch.allclose(velocity(most).norm(dim=-1), free.norm(dim=-1).clamp_max(most), rtol=1e-4)


@pytest.mark.parametrize("frames_back", [1, 4])
def test_a_body_that_strayed_has_as_many_frames_to_come_back_as_asked(data, batch, frames_back):
    """Standing still for one frame, the change that is wanted next is the recorded one and a part of the lost one."""
    module = build("wandr", data, frames_per_step=0, frames_back=frames_back)
    recordings = Recordings.of(batch, 30.0)
    still = module.network.delta(torch.tensor([0.0, 0, 0, *(1, 0, 0, 0, 1, 0) * 22]))
    wanted = []

    def stand_still(target, condition, generator):
        wanted.append(module.network.delta.undone(target))
        return still.expand_as(target), target, target

    module._reconstructed = stand_still
    module._chunks(recordings, 2, torch.Generator())
    places = starts(recordings, 2)
    first, second, third = (recordings.states(places.later(frames)) for frames in (0, 1, 2))
    assert torch.allclose(wanted[0], first.delta_to(second), atol=1e-5)
    expected = torch.lerp(second.delta_to(third), first.delta_to(third), 1 / frames_back)
    assert torch.allclose(wanted[1], expected, atol=1e-5)


def test_muon_moves_the_matrices_between_hidden_layers(data):
    module = build("wandr", data)
    moved = {id(matrix) for matrix in module.hidden_matrices()}
    named = [name for name, parameter in module.network.named_parameters() if id(parameter) in moved]
    assert len(named) == 2 * (TINY["layers"] - 2)
    assert all(name.endswith("weight") for name in named)


def test_chunks_do_not_overlap_and_stay_inside():
    recordings = Recordings.of(_walk(20), 20.0)  # frames 0 to 20, 0 being the one before
    assert starts(recordings, 6).frame.tolist() == [1, 7, 13]
    assert starts(recordings, 1).frame.tolist() == list(range(1, 20))
    assert len(starts(recordings, 6).some(2, torch.Generator()).row) == 2


def test_losses_worked_by_hand():
    decoded = torch.zeros(2, 135)
    decoded[:, 0], decoded[:, 3], decoded[:, 9] = 3.0, 6.0, 126.0
    assert float(delta_loss(decoded, torch.zeros(2, 135))) == pytest.approx(9 / 3 + 36 / 6 + 126)
    moved = torch.zeros(1, 22, 3)
    moved[0, 4, 1] = 0.66  # 66 cm in one coordinate of 66
    assert float(joint_loss(moved, torch.zeros(1, 22, 3))) == pytest.approx(66)
    mean, log_variance = torch.tensor([[2.0, 0.0]]), torch.tensor([[0.0, 0.0]])
    assert float(divergence(mean, log_variance, 0.05)) == pytest.approx((2.0 + 0.05) / 2)


def test_statistics_are_those_of_the_training_split(data):
    network = build("wandr", data).network
    whole = Recordings.of(collate([data[index] for index in range(len(data))]), 30.0)
    places = starts(whole, 1)
    deltas = whole.deltas(places).double()
    assert torch.allclose(network.delta.mean, deltas.mean(0).float(), atol=1e-5)
    assert torch.allclose(network.delta.std, deltas.std(0, correction=0).clamp_min(1e-3).float(), atol=1e-5)
    assert (network.seen.std >= 0.0199).all()


def test_chunks_grow_with_the_steps_and_stay_out_of_validation(data, batch):
    module = build("wandr", data, longest_chunk=4, steps_per_chunk_frame=10)
    drawn = {
        step: {module.chunk_length(step, module.generator(seed)) for seed in range(60)} for step in (-1, 9, 25, 900)
    }
    assert drawn == {-1: {0}, 9: {0}, 25: {0, 1, 2}, 900: {0, 1, 2, 3, 4}}
    module.chunk_length = lambda step, generator: 3
    losses = module(batch, 0)
    assert float(losses["own_changes"]) > 0
    losses["loss"].backward()
    gradients = [parameter.grad for parameter in module.network.parameters()]
    assert all(gradient is not None and torch.isfinite(gradient).all() for gradient in gradients)


def test_conditions_hold_the_goal_and_nothing_else_of_the_future(data, batch):
    module = build("wandr", data)
    recordings = Recordings.of(batch, 30.0)
    places = Places(torch.arange(6), torch.full((6,), 5))
    goals = recordings.n_frames - 1

    changed = recordings.joints.clone()
    changed[:, 6:40] += 0.5
    before = _condition(module, recordings, places, goals)
    after = _condition(module, dataclasses.replace(recordings, joints=changed), places, goals)
    assert torch.allclose(before, after, atol=1e-4)
    changed[places.row, goals] += 0.5
    elsewhere = _condition(module, dataclasses.replace(recordings, joints=changed), places, goals)
    assert not torch.allclose(before, elsewhere, atol=1e-2)
    assert not _condition(module, recordings, Places(places.row, goals), goals)[:, -9:].any()


@pytest.mark.parametrize("losses", ["single", "chunks"])
def test_the_change_that_is_wanted_is_no_part_of_the_condition(losses, data, batch, monkeypatch):
    module, recordings = build("wandr", data, frames_per_step=0), Recordings.of(batch, 30.0)
    given, inner = [], module.network.condition
    monkeypatch.setattr(
        module.network, "condition", lambda seen, delta, i: (given.append(delta), inner(seen, delta, i))[1]
    )
    if losses == "single":
        module._single_changes(recordings, torch.Generator())
    else:
        module._chunks(recordings, 2, torch.Generator())
    places = starts(recordings, 1 if losses == "single" else 2)
    assert torch.equal(given[0], recordings.deltas(places.later(-1)))


def test_corpora_without_goals_can_be_learnt_from(tmp_path):
    clips = SequenceDataset([corpus_table(tmp_path / "corpus").folder], cache=tmp_path / "cache")
    module = build("wandr", clips)
    assert torch.isfinite(module(collate([clips[index] for index in range(3)]), 5)["loss"])


def test_chunks_with_drawn_latents_never_ask_the_encoder(data, batch):
    module = build("wandr", data, own_latents="drawn")
    module.network.encode = None
    losses = module._chunks(Recordings.of(batch, 30.0), 3, torch.Generator().manual_seed(0))
    assert float(losses["own_changes"].detach()) > 0
