"""Training of WANDR: what it learns from, what a step may not see, and that it learns."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.cli import main
from prbench.errors import InputFileError, UsageError
from prbench.geometry.skeleton import Joint
from prbench.harness.methods.installed import list_tasks, load_task
from prbench.harness.methods.loading import load_adapter
from prbench.representation import mirror
from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.configuration import load_configuration
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from prbench_adapters.wandr.network import WandrNetwork
from prbench_adapters.wandr.training import (
    Places,
    Recordings,
    WandrTask,
    WandrTraining,
    delta_loss,
    divergence,
    goal_frames,
    joint_loss,
    read_model_table,
    starts,
)
from tests.adapters.training.tables import corpus_table
from tests.adapters.wandr import tiny
from tests.adapters.wandr.tiny import TINY
from tests.fakes import STANDING, fake_dataset

TRAINED_FOR = {"frames_per_step": 200, "steps_per_chunk_frame": 1, "dropout": 0.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wandr-training")
    fake_dataset(folder / "table", n=24)
    return folder


@pytest.fixture(scope="module")
def data(folder: Path) -> SequenceDataset:
    return SequenceDataset([folder / "table"], cache=folder / "cache")


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return collate([data[index] for index in range(6)])


def _build(data: SequenceDataset, *, initial: Path | None = None, seed: int = 0, **model: object) -> WandrTraining:
    torch.manual_seed(seed)
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    return WandrTask().build({**TINY, **TRAINED_FOR, **model}, data=given, initial=initial, stage="finetune")


def _walk(n_frames: int, *, wrist: Joint = Joint.RIGHT_WRIST, goal_known: bool = True) -> MotionBatch:
    """One body that slides along +Z, 10 cm a frame; its goal is where a wrist ends."""
    moved = np.arange(-1, n_frames)[:, None, None] * np.array([0.0, 0.0, 0.1])
    joints = (STANDING + moved).astype(np.float32)
    joints[:, Joint.RIGHT_WRIST, 1] += 0.2  # otherwise it is its own mirror image
    item = dataclasses.make_dataclass("Item", [field.name for field in dataclasses.fields(MotionBatch)])
    values = {field.name: None for field in dataclasses.fields(MotionBatch)} | {
        "features": torch.zeros(1, n_frames, 263),
        "joints": torch.from_numpy(joints[None, 1:]),
        "padding": torch.zeros(1, n_frames, dtype=torch.bool),
        "n_frames": torch.tensor([n_frames]),
        "text": ("walks",),
        "initial_joints": torch.from_numpy(joints[None, 1]),
        "previous_joints": torch.from_numpy(joints[None, 0]),
        "goal_joints": torch.from_numpy(joints[None, -1]),
        "goal_location": torch.from_numpy(joints[None, -1, wrist]) * (1.0 if goal_known else torch.nan),
        "fps": 20.0,
        "sequence_id": ("one",),
    }
    return MotionBatch(**vars(item(**values)))


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


def test_goals_are_in_the_last_frame_where_there_are_some_and_made_up_elsewhere():
    sequence = Recordings.of(_walk(40), 30.0)
    places = starts(sequence, 1)
    generator = torch.Generator().manual_seed(0)
    assert (goal_frames(sequence, places, generator) == 60).all()

    clip = dataclasses.replace(sequence, has_goal=torch.tensor([False]))
    drawn = torch.stack([goal_frames(clip, places, generator) for _ in range(200)])
    walked = (drawn - places.frame) * 0.1 * 20 / 30
    nothing = drawn == places.frame
    assert (nothing == ((60 - places.frame) * 0.1 * 20 / 30 < 1.5)).all()
    assert (walked[~nothing] >= 1.5 - 1e-4).all()
    assert set(drawn[:, 0].tolist()) == set(range(24, 61))  # from the first frame on: 23 frames are 1.53 m


def test_a_share_of_the_frames_of_motions_with_a_goal_gets_a_pseudo_goal():
    sequence = Recordings.of(_walk(40), 30.0)
    places = starts(sequence, 1)
    generator = torch.Generator().manual_seed(0)
    drawn = torch.stack([goal_frames(sequence, places, generator, pseudo_share=0.5) for _ in range(200)])
    far = (60 - places.frame) * 0.1 * 20 / 30 >= 1.5
    assert float((drawn[:, 0] == 60).float().mean()) == pytest.approx(0.5, abs=0.1)
    assert (drawn[:, ~far] == 60).all(), "near the goal nothing is far enough away, and the goal stays"


def test_intentions_are_as_limited_in_training_as_in_generation(data, batch):
    recordings = Recordings.of(batch, 30.0)
    places = Places(torch.arange(6), torch.full((6,), 5))
    goals = recordings.n_frames - 1

    def velocity(most_speed):
        module = _build(data, most_speed=most_speed)
        seen = module._condition(
            recordings,
            places,
            goals,
            recordings.states(places),
            delta=recordings.deltas(places.later(-1)),
            joints=recordings.joints[places.index],
        )
        return seen[:, -9:-6]

    free = velocity(0.0)
    most = float(free.norm(dim=-1).max()) / 2
    assert torch.allclose(velocity(most).norm(dim=-1), free.norm(dim=-1).clamp_max(most), rtol=1e-4)


def test_a_body_that_strayed_has_as_many_frames_to_come_back_as_asked(data, batch):
    """Standing still for one frame, the change that is wanted next is the recorded one and a part of the lost one."""
    module = _build(data, frames_per_step=0, frames_back=4)
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
    whole = first.delta_to(third)
    assert torch.allclose(wanted[1], torch.lerp(second.delta_to(third), whole, 0.25), atol=1e-5)


def test_muon_moves_the_matrices_between_hidden_layers(data):
    module = _build(data)
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
    network = _build(data).network
    whole = Recordings.of(collate([data[index] for index in range(len(data))]), 30.0)
    places = starts(whole, 1)
    deltas = whole.deltas(places).double()
    assert torch.allclose(network.delta.mean, deltas.mean(0).float(), atol=1e-5)
    assert torch.allclose(network.delta.std, deltas.std(0, correction=0).clamp_min(1e-3).float(), atol=1e-5)
    assert (network.seen.std >= 0.0199).all()


def test_padding_and_other_rows_leave_no_trace(data):
    module = _build(data, frames_per_step=0)
    module.seed = 1
    alone = module(collate([data[0]]), 0)
    batch = collate([data[0]])
    padded = dataclasses.replace(
        batch,
        joints=torch.cat((batch.joints, torch.full_like(batch.joints, torch.nan)), 1),
        features=torch.cat((batch.features, batch.features), 1),
        padding=torch.cat((batch.padding, ~batch.padding), 1),
    )
    assert float(module(padded, 0)["loss"].detach()) == pytest.approx(float(alone["loss"].detach()), rel=1e-5)


def test_a_step_is_a_function_of_its_number(data, batch):
    module = _build(data)
    first, again, other = (module(batch, step)["loss"] for step in (7, 7, 8))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_chunks_grow_with_the_steps_and_stay_out_of_validation(data, batch):
    module = _build(data, longest_chunk=4, steps_per_chunk_frame=10)
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


def test_the_networks_own_output_is_what_chunks_go_on_from(data, batch):
    """Standing still for two frames, the second change that is wanted is as large as both recorded ones together."""
    module = _build(data, frames_per_step=0)
    recordings = Recordings.of(batch, 30.0)
    still = module.network.delta(torch.tensor([0.0, 0, 0, *(1, 0, 0, 0, 1, 0) * 22]))
    wanted = []

    def stand_still(target, condition, generator):
        wanted.append(module.network.delta.undone(target))
        return still.expand_as(target), target, target

    module._reconstructed = stand_still
    module._chunks(recordings, 2, torch.Generator())
    places = starts(recordings, 2)
    both = recordings.states(places).delta_to(recordings.states(places.later(2)))
    assert torch.allclose(wanted[1], both, atol=1e-5)


def test_conditions_hold_the_goal_and_nothing_else_of_the_future(data, batch):
    module = _build(data)
    recordings = Recordings.of(batch, 30.0)
    places = Places(torch.arange(6), torch.full((6,), 5))
    goals = recordings.n_frames - 1

    def condition(recordings):
        return module._condition(
            recordings,
            places,
            goals,
            recordings.states(places),
            delta=recordings.deltas(places.later(-1)),
            joints=recordings.joints[places.index],
        )

    changed = recordings.joints.clone()
    changed[:, 6:40] += 0.5
    before, after = condition(recordings), condition(dataclasses.replace(recordings, joints=changed))
    assert torch.allclose(before, after, atol=1e-4)
    changed[places.row, goals] += 0.5
    assert not torch.allclose(before, condition(dataclasses.replace(recordings, joints=changed)), atol=1e-2)
    at_goal = Places(places.row, goals)
    assert not module._condition(
        recordings,
        at_goal,
        goals,
        recordings.states(at_goal),
        delta=recordings.deltas(Places(places.row, goals - 1)),
        joints=recordings.joints[at_goal.index],
    )[:, -9:].any()


@pytest.mark.parametrize("losses", ["single", "chunks"])
def test_the_change_that_is_wanted_is_no_part_of_the_condition(losses, data, batch, monkeypatch):
    module, recordings = _build(data, frames_per_step=0), Recordings.of(batch, 30.0)
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


def test_it_learns(data):
    """The made-up bodies change their bones, so their joints cannot be met; their changes can."""
    module = _build(data, joint_loss_weight=0.0, longest_chunk=1)
    batch = collate([data[0], data[1]])
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-2)
    losses = []
    for step in range(60):
        parts = module(batch, step)
        optimiser.zero_grad()
        parts["loss"].backward()
        optimiser.step()
        losses.append(float(parts["changes"]))
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


def test_corpora_without_goals_can_be_learnt_from(tmp_path):
    clips = SequenceDataset([corpus_table(tmp_path / "corpus").folder], cache=tmp_path / "cache")
    module = _build(clips)
    assert torch.isfinite(module(collate([clips[index] for index in range(3)]), 5)["loss"])


def test_fine_tuning_goes_on_from_weights_and_keeps_their_statistics(data, tmp_path):
    before = _build(data, seed=1)
    before.network.delta.mean += 0.25
    path = tmp_path / "before.safetensors"
    tensors, metadata = before.weights()
    write_weights(path, tensors, metadata, {})
    after = _build(data, initial=path, seed=2, original_deviation=True)
    assert all(
        torch.equal(a, b) for a, b in zip(before.state_dict().values(), after.state_dict().values(), strict=True)
    )
    assert after.network.configuration.original_deviation
    assert "before.safetensors" in after.origin[0]
    with pytest.raises(InputFileError, match=r"configuration\.layers: expected 4.*Add --set model\.layers=3"):
        _build(data, initial=path, layers=4)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"width": 3}, "unknown field"),
        ({"layers": "x"}, "layers"),
        ({"free_bits": -1.0}, "free_bits"),
        ({"pseudo_goals": 2.0}, "pseudo_goals"),
    ],
)
def test_impossible_models_are_refused(model, message, data):
    with pytest.raises(UsageError, match=message):
        _build(data, **model)


def test_the_smoke_configuration_trains_and_its_weights_generate(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    command = ["train", "--method", "wandr", "--config", "smoke", "--data", str(folder / "table")]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    card = json.loads((tmp_path / "out" / "weights.json").read_text())
    assert (card["method"], card["finished"], card["steps"]) == ("wandr", True, 5)
    assert {"changes", "divergence", "positions", "own_changes"} <= set(card["learning_curve"][-1])
    motions = load_adapter("wandr", tmp_path / "out", {}, "cpu").generate(tiny.batch(), seed=0)
    assert np.isfinite(motions.joints).all()


def test_the_method_is_trainable_by_its_one_line():
    assert "wandr" in list_tasks()
    assert isinstance(load_task("wandr"), WandrTask)


@pytest.mark.parametrize("name", ["paper", "small", "smoke"])
def test_configurations_are_complete_and_of_their_size(name):
    configuration = load_configuration(name, package="prbench_adapters.wandr", task="wandr", stage="finetune")
    network, _ = read_model_table(configuration.model)
    parameters = sum(parameter.numel() for parameter in WandrNetwork(network).parameters())
    assert parameters == pytest.approx({"paper": 4.15e6, "small": 1.19e6, "smoke": 3.1e4}[name], rel=0.01)


def test_chunks_with_drawn_latents_never_ask_the_encoder(data, batch):
    module = _build(data, own_latents="drawn")
    module.network.encode = None
    losses = module._chunks(Recordings.of(batch, 30.0), 3, torch.Generator().manual_seed(0))
    assert float(losses["own_changes"].detach()) > 0
