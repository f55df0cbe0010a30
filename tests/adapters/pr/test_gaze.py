"""The gaze network of P&R: what it sees, draws and learns, and that motions stay as they are."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.errors import AdapterError, TableError, UsageError
from prbench.geometry.boxes import Boxes
from prbench.geometry.skeleton import Joint
from prbench.harness.methods.training_tasks import load_task
from prbench_adapters.pr import load
from prbench_adapters.pr.gaze.generation import with_gaze
from prbench_adapters.pr.gaze.network import (
    GazeConfiguration,
    GazeNetwork,
    History,
    Mixture,
    Seen,
    contents,
    load_network,
    on_goal,
    turned,
    turned_back,
)
from prbench_adapters.pr.gaze.training import build
from prbench_adapters.training import SequenceDataset, TrainingData, collate
from prbench_adapters.training.run import resolved
from prbench_adapters.training.weights import write_weights
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import STANDING, fake_dataset, smooth_motion

EYES = {"optimise": "off", "gaze": "eyes"}


def network(**settings) -> GazeNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return GazeNetwork(GazeConfiguration(**{"width": 16, **settings})).double().eval().requires_grad_(False)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Weights of a tiny P&R and of a tiny gaze network."""
    folder = tmp_path_factory.mktemp("weights")
    tensors, header = contents(network())
    write_weights(folder / "gaze.safetensors", tensors, header, {})
    return tiny.write(folder / "pr.safetensors", goal="location"), folder / "gaze.safetensors"


def motions(frames: int = 30, n: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    joints = np.stack([smooth_motion(f"gaze-{row}", frames) for row in range(n)])
    goal = torch.tensor([[0.3, 0.8, 1.0], [-0.5, 1.1, 2.0]], dtype=torch.float64)[:n]
    return torch.from_numpy(joints).double(), torch.tensor([frames, frames - 7])[:n], goal


def looked_at() -> Seen:
    joints, n_frames, goal = motions()
    return Seen.of(joints, n_frames, goal, 20.0)


def test_the_axes_are_those_of_the_head_and_the_goal_is_seen_from_it():
    standing = torch.from_numpy(np.tile(STANDING, (1, 3, 1, 1))).double()
    head = standing[0, 0, Joint.HEAD]
    seen = Seen.of(standing, torch.tensor([3]), (head + torch.tensor([2.0, 0.0, 0.0]))[None], 20.0)
    assert torch.allclose(seen.axes @ seen.axes.transpose(-1, -2), torch.eye(3).double().expand(1, 3, 3, 3), atol=1e-6)
    assert torch.allclose(seen.goal[0, 1], torch.tensor([1.0, 0.0, 0.0]).double(), atol=1e-6)  # to the left
    vectors = torch.randn(1, 3, 3, dtype=torch.float64)
    assert torch.allclose(turned_back(seen.axes, turned(seen.axes, vectors)), vectors)


def test_what_is_seen_does_not_depend_on_where_the_motion_stands_or_faces():
    joints, n_frames, goal = motions()
    turn = torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]).double()
    moved = torch.tensor([3.0, 0.0, -2.0]).double()
    other = Seen.of(joints @ turn.T + moved, n_frames, goal @ turn.T + moved, 20.0)
    assert torch.allclose(looked_at().features, other.features, atol=1e-9)


def test_padding_changes_nothing():
    joints, n_frames, goal = motions()
    spoilt = joints.clone()
    spoilt[1, 23:] = 7.0
    seen, other = Seen.of(joints, n_frames, goal, 20.0), Seen.of(spoilt, n_frames, goal, 20.0)
    assert torch.equal(seen.features[1, :23], other.features[1, :23])


@pytest.mark.parametrize("concentration", [0.5, 50.0, 1e4])
def test_draws_follow_the_density(concentration):
    mean = torch.tensor([0.6, 0.0, 0.8]).double()
    n = 20_000
    flat = torch.zeros(n, 5).double().log_softmax(dim=-1)
    mixture = Mixture(flat, mean.expand(n, 5, 3), torch.full((n, 5), concentration).double())
    noise = torch.from_numpy(np.random.default_rng(1).random((n, 3)))
    drawn = mixture.drawn(noise)
    assert torch.allclose(drawn.norm(dim=-1), torch.ones(n).double())
    # Mean cosine of the distribution: coth(k) - 1 / k.
    expected = 1 / math.tanh(concentration) - 1 / concentration
    assert float((drawn @ mean).mean()) == pytest.approx(expected, abs=4 * (1 - expected) / math.sqrt(n) + 1e-12)
    sphere = torch.from_numpy(np.random.default_rng(2).normal(size=(200_000, 3)))
    sphere = sphere / sphere.norm(dim=-1, keepdim=True)
    one = Mixture(flat[0], mean.expand(5, 3), torch.full((5,), concentration).double())
    if concentration < 1e3:  # a narrow one is met by too few points of the sphere
        assert float(one.log_density(sphere).exp().mean()) * 4 * math.pi == pytest.approx(1.0, rel=0.05)


def test_the_first_number_of_the_noise_chooses_the_component():
    weights = torch.tensor([0.2, 0.5, 0.3]).double()
    means = torch.eye(3).double()
    mixture = Mixture(weights.log(), means, torch.full((3,), 1e6).double())
    for noise, component in ((0.1, 0), (0.21, 1), (0.69, 1), (0.71, 2), (0.999999, 2)):
        drawn = mixture.drawn(torch.tensor([noise, 0.5, 0.5]).double())
        assert int(drawn.argmax()) == component


def test_drawing_frame_by_frame_sees_the_history_that_training_shows_at_once():
    seen = looked_at()
    eyes = network()
    noise = torch.from_numpy(np.random.default_rng(0).random((2, 30, 3)))
    directions = eyes.sampled(seen, noise)
    history = History.of(seen, directions, on_goal(turned(seen.axes, directions), seen.goal), 0)
    again = turned_back(seen.axes, eyes(seen, history).drawn(noise))
    assert torch.allclose(again, directions, atol=1e-12)


def test_motions_keep_their_bytes_and_eyes_follow_the_noise_seed_of_their_row_alone(files):
    weights, gaze = files
    batch = conditions(Condition.GOAL_LOCATION)
    plain = load(weights, options={"optimise": "off"}, device="cpu")
    eyes = load(weights, options={**EYES, "gaze-weights": str(gaze)}, device="cpu")
    assert (plain.gaze, eyes.gaze) == (False, True)
    head = plain.generate(batch, seed=0)
    both = eyes.generate(batch, seed=0)
    assert head.gaze is None
    assert np.array_equal(head.joints, both.joints)
    assert both.gaze is not None
    assert np.allclose(np.linalg.norm(both.gaze.direction, axis=-1), 1, atol=1e-6)
    other = eyes.generate(dataclasses.replace(batch, noise_seed=(*batch.noise_seed[:2], 5)), seed=1)
    n_frames = int(batch.n_frames[0])
    assert np.array_equal(other.gaze.direction[0, :n_frames], both.gaze.direction[0, :n_frames])
    assert not np.array_equal(other.gaze.direction[2], both.gaze.direction[2])
    alone = eyes.generate(batch.rows(0, 1), seed=0)
    assert np.allclose(alone.gaze.direction[0], both.gaze.direction[0, :n_frames], atol=1e-4)


def test_motions_are_led_around_boxes_before_their_eyes_are_added(files, monkeypatch):
    monkeypatch.setattr("prbench_adapters.diffusion.obstacles._ITERATIONS", 3)
    weights, gaze = files
    batch = conditions(Condition.GOAL_LOCATION, 1)
    options = {"optimise": "off", "obstacles": "avoid"}
    blind = load(weights, options=options, device="cpu")
    free = load(weights, options={"optimise": "off"}, device="cpu").generate(batch, seed=0)
    middle = free.joints[:, 10, Joint.PELVIS].astype(np.float64)
    batch = dataclasses.replace(batch, obstacles=Boxes(middle, np.eye(3)[None], np.full((1, 3), 0.15), np.arange(2)))
    led = blind.generate(batch, seed=0)
    eyes = load(weights, options={**options, "gaze": "eyes", "gaze-weights": str(gaze)}, device="cpu")
    assert (eyes.wants_obstacles, eyes.gaze) == (True, True)
    both = eyes.generate(batch, seed=0)
    assert not np.array_equal(led.joints, free.joints)
    assert np.array_equal(both.joints, led.joints)
    assert np.array_equal(both.gaze.origin, with_gaze(led, batch, eyes.eyes).gaze.origin)


def test_a_goal_pose_has_eyes_too(files, tmp_path):
    weights = tiny.write(tmp_path / "pose.safetensors", goal="pose")
    eyes = load(weights, options={**EYES, "gaze-weights": str(files[1])}, device="cpu")
    assert eyes.generate(conditions(Condition.GOAL_POSE), seed=0).gaze is not None


def test_options_that_do_not_fit_together_are_refused(files, tmp_path):
    weights, gaze = files
    with pytest.raises(ValueError, match="without gaze=eyes nothing uses them"):
        load(weights, options={"gaze-weights": str(gaze)}, device="cpu")
    with pytest.raises(ValueError, match="option 'gaze': expected head or eyes, found 'mouth'"):
        load(weights, options={"gaze": "mouth"}, device="cpu")
    tensors, header = contents(network(fps=30.0))
    write_weights(tmp_path / "gaze-30.safetensors", tensors, header, {})
    with pytest.raises(AdapterError, match="expected gaze at 20 frames a second, as the motions, found 30"):
        load(weights, options={**EYES, "gaze-weights": str(tmp_path / "gaze-30.safetensors")}, device="cpu")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> TrainingData:
    table = fake_dataset(tmp_path_factory.mktemp("gaze") / "table", 24)
    cache = tmp_path_factory.mktemp("cache")
    return TrainingData(SequenceDataset(table, mirrored=True, cache=cache), "continuous", 241)


def test_the_stage_has_a_configuration_of_its_own_that_is_the_default():
    stage, configuration = resolved(load_task("pr"), stage="gaze")
    assert stage == "gaze"
    assert configuration.model == {"width": 128, "fps": 20.0}
    assert resolved(load_task("pr"))[1].model["architecture"] == "frames"


def test_the_loss_falls_and_validation_measures_angles_beside_their_floors(data, tmp_path, monkeypatch):
    module = build({"width": 16}, data, None)
    module.seed = 3
    monkeypatch.setattr("prbench_adapters.pr.gaze.training._DRAWS", 1)
    shortest = sorted(range(len(data.train)), key=lambda row: data.train.lengths[row])[:2]
    batch = collate([data.train[row] for row in shortest])
    assert any(name.endswith("#mirrored") for name in data.train.sequence_ids)
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-2)
    losses = []
    for step in range(12):
        loss = module(batch, step)["loss"]
        losses.append(float(loss.detach()))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert losses[-1] < losses[0] - 0.5
    with torch.no_grad():
        measured = module.eval()(batch, -1)
    # The made-up gaze points along z of the first pose, which every head of these motions keeps facing.
    assert set(measured) == {
        *("loss", "nats", "eyes", "draw_deg", "mean_deg", "offset_deg", "head_deg", "goal_deg"),
    }
    assert all(math.isfinite(float(value)) for value in measured.values())
    tensors, header = module.weights()
    write_weights(tmp_path / "w.safetensors", tensors, header, {}, dtype="float16")
    assert load_network(tmp_path / "w.safetensors", "cpu").configuration.width == 16
    onwards = build({"width": 16}, data, tmp_path / "w.safetensors")
    assert torch.allclose(onwards.network.eye.weight, module.network.eye.weight, atol=1e-3)
    assert "initial weights w.safetensors" in onwards.learned_from()[1]
    assert module.learned_from() == (f"recorded gaze of {module.sequences} sequences",)


def test_what_cannot_be_learnt_from_is_refused(data):
    with pytest.raises(UsageError, match="--stage gaze needs a configuration of a gaze network"):
        build({"architecture": "frames"}, data, None)
    with pytest.raises(UsageError, match=r"data.max_frames: expected at least the \d+ frames"):
        build({}, dataclasses.replace(data, max_frames=10), None)


def test_tables_without_gaze_are_refused(data, monkeypatch):
    monkeypatch.setattr("prbench_adapters.pr.gaze.training.recorded_gaze", lambda tables, splits: {})
    with pytest.raises(TableError, match="expected training sequences with gaze, found none"):
        build({}, data, None)
