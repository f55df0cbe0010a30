"""Training of both networks in one run: losses, draws, the start of fine-tuning, and files."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.cli import main
from prbench.errors import InputFileError, UsageError
from prbench.files.storage import file_digest, read_json
from prbench.harness.methods.installed import load_task
from prbench_adapters.gmd.model import GMDModel, GMDNetworks, with_absolute_root
from prbench_adapters.gmd.training import GMDTask, GMDTraining, read_model_table
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.configuration import TrainingConfiguration, list_configurations, load_configuration
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.task import TrainingData, TrainingTask
from prbench_adapters.training.weights import write_weights
from tests.fakes import fake_dataset

PACKAGE = "prbench_adapters.gmd"
NAMES = ("paper", "small", "smoke")
TINY = {
    "motion_widths": [8, 8],
    "trajectory_widths": [8, 8],
    "condition_width": 8,
    "text_encoder": "hashed-ngrams",
    "text_dimension": 64,
    "diffusion_steps": 10,
    "padded_frames": 64,
}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> SequenceDataset:
    folder = tmp_path_factory.mktemp("training")
    return SequenceDataset([fake_dataset(folder / "table", n=24)], max_frames=60, cache=folder / "cache")


@pytest.fixture(scope="module")
def batch(data) -> MotionBatch:
    return collate([data[index] for index in range(6)])


def _build(data: SequenceDataset, *, initial: Path | None = None, seed: int = 0, **model: object) -> GMDTraining:
    torch.manual_seed(seed)
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    return GMDTask().build({**TINY, **model}, data=given, initial=initial, stage="finetune")


def _saved(module: GMDTraining, path: Path, **keywords: str) -> Path:
    tensors, metadata = module.weights()
    write_weights(path, tensors, metadata, {}, **keywords)
    return path


def test_statistics_are_those_of_absolute_features(data):
    space = _build(data).space(torch.device("cpu"))
    raw = torch.cat([with_absolute_root(torch.tensor(data[index].features)) for index in range(len(data))])
    assert torch.allclose(space.mean, raw.mean(dim=0), atol=1e-4)
    assert torch.allclose(space.std[1:3], raw[:, 1:3].std(dim=0, correction=0).mean().expand(2), rtol=1e-3)
    assert not np.allclose(space.std[:3].numpy(), data.statistics().std[:3], rtol=0.5)


def test_the_losses_of_untrained_networks_are_the_variances_of_what_they_predict(data, batch):
    """Networks that say zero: the trajectory's noise has variance 1, projected features about 1 as well."""
    module = _build(data)
    for network in (module.networks.motion, module.networks.trajectory):
        torch.nn.init.zeros_(network.head[1].weight)
        torch.nn.init.zeros_(network.head[1].bias)
    losses = module(batch, 0)
    assert float(losses["trajectory"]) == pytest.approx(1.0, abs=0.1)
    assert 0.3 < float(losses["motion"]) < 3.0
    assert torch.equal(losses["loss"], losses["motion"] + losses["trajectory"])


def test_decoded_joints_are_part_of_the_loss_where_they_weigh(data, batch):
    plain = _build(data)(batch, 0)
    weighed = _build(data, joint_loss_weight=2.0, bone_loss_weight=3.0, path_step_weight=0.5)(batch, 0)
    assert "joints" not in plain
    parts = weighed["motion"] + weighed["trajectory"] + 2 * weighed["joints"] + 3 * weighed["bones"]
    assert torch.allclose(weighed["loss"], parts + 0.5 * weighed["path_steps"], rtol=1e-5)
    assert torch.allclose(weighed["motion"], plain["motion"])


def test_a_network_that_knows_the_motion_has_no_loss_of_joints(data, batch):
    module = _build(data, joint_loss_weight=1.0, bone_loss_weight=1.0)
    space = module.space(torch.device("cpu"))
    projected = space.projected(space.standardised(with_absolute_root(batch.features)))
    found = module._motion_losses(projected, projected, batch, space)
    assert float(found["loss"]) < 1e-6


def test_padding_leaves_no_trace_in_the_losses(data, batch):
    module, other = _build(data), batch.features.clone()
    other[batch.padding] = 7.0
    changed = MotionBatch(**{**batch.__dict__, "features": other})
    assert torch.equal(module(batch, 3)["loss"], module(changed, 3)["loss"])


def test_draws_depend_on_seed_step_and_rank_alone(data, batch):
    module, other = _build(data), _build(data, seed=5)
    clean = batch.features
    for name in ("step", "without_text", "noise"):
        drawn = [getattr(each.draw(clean, each.generator(7)), name) for each in (module, other)]
        assert torch.equal(*drawn)
    other.rank = 1
    noises = [each.draw(clean, each.generator(step)).noise for each, step in ((module, 7), (other, 7), (module, 8))]
    assert not torch.equal(noises[0], noises[1])
    assert not torch.equal(noises[0], noises[2])


def test_text_is_hidden_as_often_as_asked(data, batch):
    module = _build(data, text_drop=0.3)
    hidden = torch.cat([module.draw(batch.features, module.generator(step)).without_text for step in range(300)])
    assert float(hidden.float().mean()) == pytest.approx(0.3, abs=0.05)


def test_each_network_learns_and_is_clipped_by_itself(data, batch):
    module = _build(data)
    groups = module.gradient_groups()
    assert [len(group) for group in groups] == [
        len(list(network.parameters())) for network in (module.networks.motion, module.networks.trajectory)
    ]
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-2)
    before = {name: value.clone() for name, value in module(batch, 0).items()}
    for _ in range(8):  # the same draws: this must be learnt by heart
        optimiser.zero_grad()
        module(batch, 0)["loss"].backward()
        optimiser.step()
    after = module(batch, 0)
    assert float(after["motion"]) < 0.9 * float(before["motion"])
    assert float(after["trajectory"]) < 0.9 * float(before["trajectory"])


def test_fine_tuning_continues_networks_statistics_and_projection(data, tmp_path):
    first = _build(data, seed=1)
    first.space(torch.device("cpu")).mean.add_(0.25)
    second = _build(data, initial=_saved(first, tmp_path / "first.safetensors"), seed=2)
    for name, tensor in first.weights()[0].items():
        assert torch.equal(second.weights()[0][name], tensor), name
    assert any("initial weights first.safetensors" in line for line in second.origin)


def test_half_precision_keeps_the_projection_to_the_bit(data, tmp_path):
    module = _build(data)
    model = GMDModel.load(_saved(module, tmp_path / "half.safetensors", dtype="float16"))
    assert torch.equal(model.space.projection, module.space(torch.device("cpu")).projection)
    assert torch.equal(model.space.inverse, module.space(torch.device("cpu")).inverse)


def test_weights_of_other_sizes_are_no_start(data, tmp_path):
    path = _saved(_build(data, diffusion_steps=20), tmp_path / "first.safetensors")
    with pytest.raises(InputFileError, match=r"diffusion_steps: expected 10, .* found 20. Add --set model.diff"):
        _build(data, initial=path)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ({"width": 3}, r"\[model\]: .*unknown field `width`"),
        ({"motion_widths": [9]}, r"\[model\]: 'motion_widths' must be .* multiples of 8"),
        ({"text_dimension": 63}, "model.text_dimension: the text encoder 'hashed-ngrams' has vectors of 64 numbers"),
        ({"max_frames": 59}, "data.max_frames: expected at most the model's 59, found 60"),
        ({"representation": "reference"}, "data.mode: the model expects reference, found continuous"),
    ],
)
def test_tables_that_describe_no_model_are_refused(data, model, message):
    with pytest.raises(UsageError, match=message):
        _build(data, **model)


def _train(table: Path, out: Path, *more: str) -> int:
    command = ["train", "--method", "gmd", "--config", "smoke", "--data", str(table), "--out", str(out)]
    return main([*command, "--set", "training.save_every=2", *more])


def test_smoke_training_makes_weights_that_generate_and_resumes_to_the_same_bytes(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    table = fake_dataset(tmp_path / "table", 24).folder
    validated = ("--set", "validation.every=4", "--set", "validation.sequences=1")
    assert _train(table, tmp_path / "whole", *validated) == 0
    card = read_json(tmp_path / "whole" / "weights.json")
    assert card["steps"] == 4
    assert card["validation"][-1]["loss"] > 0
    model = GMDModel.load(tmp_path / "whole" / "weights.safetensors")
    assert model.configuration.diffusion_steps == 10

    assert _train(table, tmp_path / "resumed") == 0
    newest = sorted((tmp_path / "resumed" / "checkpoints").iterdir())[-1]
    for file in newest.iterdir():
        file.unlink()
    newest.rmdir()  # as if it had been killed after step 2
    (tmp_path / "resumed" / "weights.safetensors").unlink()
    assert _train(table, tmp_path / "resumed") == 0
    assert file_digest(tmp_path / "resumed" / "weights.safetensors") == card["weights_sha256"]
    capsys.readouterr()


def _load(name: str, stage: str) -> TrainingConfiguration:
    return load_configuration(name, package=PACKAGE, task="gmd", stage=stage)


def test_the_task_is_found_beside_the_method():
    task = load_task("gmd")
    assert isinstance(task, TrainingTask)
    assert list_configurations(task.configurations, task.name) == NAMES


@pytest.mark.parametrize("stage", ["pretrain", "finetune"])
@pytest.mark.parametrize("name", NAMES)
def test_data_and_model_of_a_configuration_fit_together(name, stage):
    configuration = _load(name, stage)
    model, objective = read_model_table(configuration.model)
    assert configuration.data.max_frames <= model.max_frames
    assert configuration.data.mode == model.representation
    assert objective.text_drop == 0.1
    assert model.max_frames == 241


def test_small_networks_fit_the_package_as_float16():
    model, _ = read_model_table(_load("small", "finetune").model)
    networks = GMDNetworks(model)
    parameters = sum(parameter.numel() for parameter in networks.parameters())
    vectors = sum(parameter.numel() for parameter in networks.parameters() if parameter.ndim < 2)
    assert 0.9e6 < parameters < 1.2e6
    assert 2 * parameters + 2 * vectors + 2 * 263**2 + 40_000 < 2.5e6  # bytes: networks, projection, header
    assert (model.diffusion_steps, model.text_encoder) == (100, "hashed-ngrams")


def test_the_paper_configuration_holds_the_numbers_of_the_original():
    """docs/specification/gmd.md#networks; the meta device has shapes without numbers."""
    pretraining, fine_tuning = _load("paper", "pretrain"), _load("paper", "finetune")
    model, _ = read_model_table(pretraining.model)
    assert (model.diffusion_steps, model.padded_frames, model.emphasis) == (1000, 224, 10.0)
    assert (model.motion_widths, model.trajectory_widths) == ((1024,) * 4, (64, 128, 256))
    assert (pretraining.training.steps, fine_tuning.training.steps) == (500_000, 250_000)
    assert (pretraining.training.batch_size, pretraining.training.ema) == (64, 0.9999)
    assert (pretraining.training.weight_decay, pretraining.training.gradient_clip) == (0.01, 1.0)


def test_every_number_of_the_paper_configuration_names_its_source():
    sourced = ("paper", "GMD", "choice", "DistilBERT")
    for line in resources.files(PACKAGE).joinpath("gmd-paper.toml").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition("=")
        bookkeeping = key.strip() in {"mode", "save_every", "log_every", "sequences", "condition"}
        if value and not line.startswith("#") and not bookkeeping:
            assert any(word in value.partition("#")[2] for word in sourced), line
