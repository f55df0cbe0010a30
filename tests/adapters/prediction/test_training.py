"""The predictors from a table of windows to futures: training, resumption, weights, and who may ask for what."""

from __future__ import annotations

import dataclasses
import json
import math
import signal
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.errors import AdapterError, InputFileError, PrbenchError, TrainingStopped, UsageError
from prbench.geometry.skeleton import BONES, Joint
from prbench.harness.methods.installed import load_task
from prbench_adapters.prediction.adapter import LearnedPredictor, load_predictor
from prbench_adapters.prediction.configuration import preset
from prbench_adapters.prediction.training import RateCourse, _augmented_alike, augmented, mirror_partners
from prbench_adapters.training.batches import WindowChoice, WindowsDataset
from prbench_adapters.training.run import TrainRequest, resolved, train
from prbench_adapters.training.weights import read_weights
from prbench_benchmarks.motion_prediction.batch import Condition, ObservedBatch, ask
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write

FIRST = {"dlow": "cvae", "belfusion": "autoencoders"}
"""What each method's training starts from."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("predictors")
    splits = ("train", "train", "validation", "test")
    write(folder / "windows", *(walking(f"r{n}", 150, split=split, number=n) for n, split in enumerate(splits)))
    return folder


class Trained:
    """Smoke trainings, made when they are first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def request(self, name: str, out: str, *settings: tuple[str, str]) -> TrainRequest:
        """The training of a method, or of ``autoencoders``."""
        method = "belfusion" if name == "autoencoders" else name
        stage = {"autoencoders": "autoencoders", "belfusion": "diffusion"}.get(name)
        return TrainRequest(
            method=method,
            data=(self.folder / "windows",),
            out=self.folder / out,
            stage=stage,
            configuration="smoke",
            overrides=(("training.steps", "4"), ("training.save_every", "2"), ("validation.every", "4"), *settings),
            initial=self.weights(FIRST[name]) if name in FIRST else None,
        )

    def weights(self, name: str) -> Path:
        """The weights of a smoke training."""
        path = self.folder / name / "weights.safetensors"
        if not path.is_file():
            train(self.request(name, name))
        return path

    def predictor(self, name: str, **options: str) -> LearnedPredictor:
        """The trained method."""
        return load_predictor(name, self.weights(name), options=options, device="cpu")

    def batch(self, condition: Condition, **choice) -> ObservedBatch:
        """The observed frames of all test windows."""
        table = WindowsTable.open(self.folder / "windows")
        return next(table.batches(condition, table.chosen(split="test"), **choice))[0]


@pytest.fixture(scope="module")
def trained(folder: Path) -> Trained:
    return Trained(folder)


CONDITIONS = {
    "gazemodiff": Condition.POSE_GAZE,
    "gazemotion": Condition.POSE_GAZE,
    "humanmac": Condition.POSE,
    "cvae": Condition.POSE,
    "dlow": Condition.POSE,
    "belfusion": Condition.POSE,
}


@pytest.mark.parametrize(("name", "condition"), CONDITIONS.items())
def test_a_smoke_training_predicts(name, condition, trained):
    predictor = trained.predictor(name)
    assert predictor.conditions == {condition}
    assert predictor.weights_for(condition) == trained.weights(name)
    batch = trained.batch(condition)
    futures = ask(predictor, batch, n_samples=5, seed=0).joints
    draws = name != "gazemotion"  # which has one future
    assert (futures[:, 0] != futures[:, 1]).any() == draws
    assert (ask(predictor, batch, n_samples=5, seed=0).joints == futures).all()
    assert (ask(predictor, batch, n_samples=5, seed=1).joints != futures).any() == draws


@pytest.mark.parametrize(("name", "condition"), CONDITIONS.items())
def test_the_batch_around_a_window_leaves_no_trace(name, condition, trained):
    predictor = trained.predictor(name, precision="float64")
    batch = trained.batch(condition)
    whole = ask(predictor, batch, n_samples=5, seed=3).joints
    alone = np.concatenate([ask(predictor, batch.rows(row, row + 1), n_samples=5, seed=3).joints for row in (1, 0)])
    np.testing.assert_allclose(alone[::-1], whole[:2], atol=1e-6)


@pytest.mark.parametrize("name", ["gazemodiff", "gazemotion", "humanmac", "cvae", "belfusion"])
def test_two_samples_are_the_first_of_five(name, trained):
    predictor = trained.predictor(name, precision="float64")
    batch = trained.batch(CONDITIONS[name]).rows(0, 2)
    five = ask(predictor, batch, n_samples=5, seed=3).joints
    np.testing.assert_allclose(ask(predictor, batch, n_samples=2, seed=3).joints, five[:, :2], atol=1e-6)


def test_the_samples_of_dlow_are_one_design(trained):
    with pytest.raises(UsageError, match=r"5 samples are one design.*found 2.*model\.n_samples=2"):
        ask(trained.predictor("dlow"), trained.batch(Condition.POSE), n_samples=2, seed=0)


def test_turning_the_room_turns_the_futures(trained):
    predictor = trained.predictor("gazemodiff", precision="float64")
    batch = trained.batch(Condition.POSE_GAZE, frame="room")
    same = trained.batch(Condition.POSE_GAZE, frame="last-pose")
    in_room = ask(predictor, batch, n_samples=1, seed=0).joints
    turned = ask(predictor, same, n_samples=1, seed=0).joints
    bones = [np.linalg.norm(joints[..., 1, :] - joints[..., 20, :], axis=-1) for joints in (in_room, turned)]
    np.testing.assert_allclose(*bones, atol=1e-4)
    assert np.abs(in_room - turned).max() > 0.1


def test_windows_of_another_rate_are_interpolated_in_time(trained):
    predictor = trained.predictor("cvae")
    batch = trained.batch(Condition.POSE).rows(0, 1)
    last = batch.observed_joints[:, -1:]
    slower = dataclasses.replace(batch, fps=20.0, n_future=40, observed_joints=np.repeat(last, 10, axis=1))
    usual = dataclasses.replace(batch, observed_joints=np.repeat(last, 15, axis=1))
    at_20 = predictor.predict(slower, n_samples=2, seed=0).joints
    at_30 = predictor.predict(usual, n_samples=2, seed=0).joints
    np.testing.assert_allclose(at_20[:, :, 1::2], at_30[:, :, 2::3], atol=1e-5)  # 0.1 s, 0.2 s, …


def test_windows_of_another_duration_and_other_joints_are_refused(trained):
    predictor = trained.predictor("cvae")
    batch = trained.batch(Condition.POSE)
    longer = dataclasses.replace(batch, n_future=90)
    with pytest.raises(AdapterError, match=r"predicts 2 s, these windows have 0\.5 s and 3 s"):
        predictor.predict(longer, n_samples=1, seed=0)
    names = batch.joint_names[:21]
    fewer = dataclasses.replace(batch, joint_names=names, observed_joints=batch.observed_joints[:, :, :21])
    with pytest.raises(AdapterError, match=r"22 joints of smpl22.*21 others"):
        predictor.predict(fewer, n_samples=1, seed=0)


def test_gaze_that_nobody_measured_is_refused(trained):
    batch = trained.batch(Condition.POSE_GAZE).rows(0, 1)
    blind = dataclasses.replace(batch, gaze_valid=np.zeros((1, 15), dtype=bool))
    with pytest.raises(AdapterError, match="gazemodiff: window 0 of the batch has no valid gaze"):
        trained.predictor("gazemodiff").predict(blind, n_samples=1, seed=0)


@pytest.mark.parametrize("name", ["gazemodiff", "belfusion"])
def test_a_training_stopped_half_way_and_resumed_ends_in_the_same_bytes(name, trained):
    whole = trained.weights(name)
    request = trained.request(name, f"{name}-in-parts")

    def stop_after_two(progress):
        if progress.step == 1:
            signal.raise_signal(signal.SIGTERM)

    with pytest.raises(TrainingStopped, match="after step 2 of 4"):
        train(request, report=stop_after_two)
    train(request)
    parts = request.out / "weights.safetensors"
    assert parts.read_bytes() == whole.read_bytes()
    assert parts.with_suffix(".json").read_bytes() == whole.with_suffix(".json").read_bytes()


def test_a_card_has_losses_and_errors_of_validation(trained):
    card = json.loads(trained.weights("gazemodiff").with_suffix(".json").read_text("utf-8"))
    (last,) = card["validation"]
    assert set(last) == {"step", "loss", "ade", "fde", "still_ade"}
    assert card["finished"]
    assert card["data"][0]["dataset"] == "synthetic-walks"


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("dlow", {"initial": None}, r"--init: dlow builds upon a trained CVAE"),
        ("gazemodiff", {"model.preset": "no-gaze"}, r"no-gaze.*model\.windows\.condition=pose"),
        ("gazemodiff", {"model.preset": "humanmac"}, r"model\.preset: expected one of gazemodiff, "),
        ("gazemodiff", {"model.gaze": "false"}, r"model\.gaze: follows from the windows"),
        (
            "cvae",
            {"model.windows.condition": "gaze"},
            r"\[model\.windows\]: Invalid enum value 'gaze'.* one of: pose, ",
        ),
        ("gazemotion", {"model.coefficients": "76"}, r"\[model\]: 'coefficients' must be at most the 75 frames"),
        ("cvae", {"model.windows.left_out": '["P0", "P1"]'}, "expected windows of split 'train'"),
        ("cvae", {"fold": "1/2"}, r"--fold: the tables of cvae have no folds"),
    ],
)
def test_what_does_not_fit_is_refused_with_a_remedy(name, settings, message, trained, tmp_path):
    given = trained.request(name, "unused") if name not in FIRST else None
    request = TrainRequest(
        method=name,
        data=(trained.folder / "windows",),
        out=tmp_path / "out",
        configuration="smoke",
        fold=settings.pop("fold", None),
        initial=settings.pop("initial", None),
        overrides=(*(given.overrides if given else ()), *settings.items()),
    )
    with pytest.raises(PrbenchError, match=message):
        train(request)


def test_a_sampler_and_its_autoencoder_must_see_the_same(trained):
    request = trained.request("dlow", "another-frame", ("model.windows.frame", "room"))
    with pytest.raises(UsageError, match="was trained on windows with frame last-pose, these have room"):
        train(request)


def test_weights_of_another_method_are_refused(trained):
    with pytest.raises(InputFileError, match="expected 'humanmac', found 'cvae'"):
        load_predictor("humanmac", trained.weights("cvae"), options={}, device="cpu")


def test_a_method_without_weights_says_how_to_train_some(monkeypatch):
    monkeypatch.setattr("prbench_adapters.prediction.adapter.bundled_names", lambda folder: [])
    with pytest.raises(AdapterError, match="prbench train --method dlow --config small"):
        load_predictor("dlow", None, options={}, device="cpu")


def test_options_are_checked(trained):
    with pytest.raises(ValueError, match="unknown option 'steps'"):
        trained.predictor("cvae", steps="3")
    with pytest.raises(ValueError, match="'sampling_steps' must divide the 20 diffusion steps"):
        trained.predictor("gazemodiff", steps="3")


def _request(trained, name, model):
    data = WindowsDataset([trained.folder / "windows"], choice=WindowChoice(**model.pop("windows", {})))
    return load_task(name).build(model, data=data, initial=None, stage="train")


@pytest.mark.parametrize(
    "name", ["no-graph-attention", "no-cross-attention", "no-gaze-encoder", "no-motion-encoder", "gazemodiff-paper"]
)
def test_ablations_are_configurations(name, trained):
    module = _request(trained, "gazemodiff", {"preset": name, "encoder_width": 4, "width": 16, "heads": 2})
    network = module.record.network
    assert network.fusion == ("concatenation" if name == "no-graph-attention" else "graph-attention")
    assert network.cross_attention is (name != "no-cross-attention")
    assert network.gaze_encoder is (name != "no-gaze-encoder")
    assert network.pose_encoder is (name != "no-motion-encoder")
    assert network.gaze


def test_the_head_takes_the_place_of_gaze(trained):
    windows = {"condition": Condition.POSE_HEAD}
    module = _request(trained, "humanmac", {"windows": windows, "width": 16, "heads": 2})
    assert module.record.network.gaze
    data = WindowsDataset([trained.folder / "windows"], choice=WindowChoice(**windows))
    batch = data.collate([data[0]])
    assert bool(batch.direction_valid.all())
    assert torch.linalg.norm(batch.motion[:, :, -1], dim=-1).numpy() == pytest.approx(1.0, abs=1e-5)


def test_the_learning_rate_follows_its_course():
    course = RateCourse(milestones=(0.25, 0.5), linear_from=0.6)
    assert [course.at(place) for place in (0.0, 0.25, 0.5, 0.8)] == pytest.approx([1.0, 0.9, 0.81, 0.405])
    falling = RateCourse(exponential_to=0.01)
    assert [falling.at(place) for place in (0.0, 0.5, 1.0)] == pytest.approx([1.0, 0.1, 0.01])
    with pytest.raises(ValueError, match="'exponential_to' must be above 0, found 0"):
        RateCourse(exponential_to=0.0)


@pytest.mark.parametrize("condition", list(Condition))
def test_gazemotion_has_nodes_for_the_direction_that_it_is_told(condition, trained):
    model = {"windows": {"condition": condition}, "blocks": 1, "width": 2}
    network = _request(trained, "gazemotion", model).network
    told = condition is not Condition.POSE
    assert len(network.graph.start.over_nodes) == (44 if told else 22)
    assert (network.forecaster is not None) is told


NAMES = [joint.name.lower() for joint in Joint]
STILL, NEVER = torch.zeros(2), torch.zeros(2, dtype=torch.bool)


@pytest.fixture
def motion():
    return torch.randn(2, 7, 23, 3, generator=torch.Generator().manual_seed(1))


def test_partners_are_found_by_either_spelling():
    partners = mirror_partners(NAMES)
    assert partners[Joint.LEFT_WRIST] == Joint.RIGHT_WRIST
    assert partners[Joint.HEAD] == Joint.HEAD
    assert [partners[partner] for partner in partners] == list(range(22))
    assert mirror_partners(["base", "lHip", "linnerShoulder", "rHip", "rinnerShoulder"]) == (0, 3, 4, 1, 2)
    with pytest.raises(ValueError, match="'left_eye' has no partner"):
        mirror_partners(["head", "left_eye"])


def test_a_mirror_exchanges_left_and_right(motion):
    found = augmented(motion, mirror_partners(NAMES), turn=STILL, mirrored=torch.tensor([True, False]))
    assert torch.equal(found[1], motion[1])
    expected = motion[0, :, Joint.RIGHT_WRIST] * torch.tensor([-1.0, 1.0, 1.0])
    assert torch.equal(found[0, :, Joint.LEFT_WRIST], expected)
    assert torch.equal(found[0, :, 22, 0], -motion[0, :, 22, 0])


def test_a_turn_is_about_the_vertical_and_keeps_bones(motion):
    turn = torch.tensor([math.pi / 2, 0.3])
    found = augmented(motion, mirror_partners(NAMES), turn=turn, mirrored=NEVER)
    torch.testing.assert_close(found[0, ..., 0], motion[0, ..., 2])
    assert torch.equal(found[..., 1], motion[..., 1])
    parents, children = map(list, zip(*BONES))
    torch.testing.assert_close(
        (found[:, :, parents] - found[:, :, children]).norm(dim=-1),
        (motion[:, :, parents] - motion[:, :, children]).norm(dim=-1),
    )
    torch.testing.assert_close(found[:, :, 22].norm(dim=-1), motion[:, :, 22].norm(dim=-1))


def test_the_published_augmentation_is_one_for_the_whole_batch_and_leaves_labels(motion):
    both = torch.cat([motion, motion])
    seen = set()
    for seed in range(12):
        found = _augmented_alike(both, torch.Generator().manual_seed(seed))
        torch.testing.assert_close(found[: len(motion)], found[len(motion) :])
        assert torch.equal(found[..., 1], both[..., 1])
        torch.testing.assert_close(found.norm(dim=-1), both.norm(dim=-1))
        # An odd number of negated axes makes a mirror: left wrists stay left wrists there.
        sides = found[:, :, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST, Joint.HEAD]]
        seen.add(bool(torch.det(sides[0, 0]).sign() == torch.det(both[0, 0, [20, 21, 15]]).sign()))
    assert seen == {True, False}


def test_no_augmentation_shows_windows_as_they_are(trained):
    shown = []
    for augmentation in ("none", "mirror"):
        given = {"windows": {"augmentation": augmentation}, "width": 16, "heads": 2, "encoder_width": 4}
        module = _request(trained, "gazemodiff", given)
        module.losses = lambda _, motion, *__: shown.append(motion) or {}
        data = WindowsDataset([trained.folder / "windows"])
        batch = data.collate([data[place] for place in range(4)])
        module(batch, 0)
        shown.append(module.shown(batch))
    assert torch.equal(shown[0], shown[1])
    assert not torch.equal(shown[2], shown[3])


def test_an_encoder_apart_keeps_its_learning_rate_and_is_not_averaged(trained):
    halted = (("model.rate.milestones", "[0.5]"), ("model.rate.factor", "1e-9"), ("training.steps", "12"))
    found = {}
    for name, more in (("one", ()), ("apart", (("model.rate.encoder_apart", "true"),))):
        train(trained.request("gazemodiff", f"optimiser-{name}", *halted, *more))
        found[name] = read_weights(
            trained.folder / f"optimiser-{name}" / "weights.safetensors", kind="gazemodiff"
        ).tensors
    moved = {key: float((found["one"][key] - found["apart"][key]).abs().max()) for key in found["one"]}
    encoder = [change for key, change in moved.items() if "encoder" in key]
    others = [change for key, change in moved.items() if "encoder" not in key]
    assert max(encoder) > 1e-3  # six further steps at 1e-3 each, not averaged
    assert max(others) < 1e-6


@pytest.mark.parametrize("name", ["paper", "code"])
def test_each_side_has_a_preset_and_a_configuration(name):
    model = resolved(load_task("gazemodiff"), name)[1].model
    assert model["preset"] == f"gazemodiff-{name}"
    assert preset(model["preset"], n_joints=21).legacy_layout is (name == "code")
    assert model["windows"]["augmentation"] == {"paper": "none", "code": "published"}[name]
    assert model["rate"].get("encoder_apart", False) is (name == "code")
