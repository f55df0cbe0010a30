"""What holds for the training of every method: draws, padding, learning, fine-tuning, resuming, refusals, sizes."""

from __future__ import annotations

import dataclasses
import json
import re
import signal
from functools import partial
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.cli import main
from prbench.contract import Condition
from prbench.errors import InputFileError, TrainingStopped, UsageError
from prbench.files.storage import read_json
from prbench.harness.methods.installed import list_tasks, load_task
from prbench.harness.methods.loading import load_adapter
from prbench.protocol.manifests import load_protocol
from prbench_adapters.dart.model import DartConfiguration, LatentDenoiser, PrimitiveVAE
from prbench_adapters.dart.training import Objective as DartObjective
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.method import bundled_weights
from prbench_adapters.diffusion.model import network
from prbench_adapters.diffusion.training import FREE_TO_CHANGE
from prbench_adapters.diffusion.training import Objective as DenoiserObjective
from prbench_adapters.gmd.model import GMDConfiguration, GMDNetworks
from prbench_adapters.gmd.training import Objective as GMDObjective
from prbench_adapters.training import collate
from prbench_adapters.training.configuration import (
    OptimisationConfiguration,
    TrainingConfiguration,
    list_configurations,
    load_configuration,
)
from prbench_adapters.training.loop import fit
from prbench_adapters.training.task import TrainingTask, split_model_table
from prbench_adapters.wandr.network import WandrConfiguration, WandrNetwork
from prbench_adapters.wandr.training import Objective as WandrObjective
from tests.adapters import trained
from tests.adapters.diffusion.goal_batches import conditions
from tests.adapters.diffusion.tiny import text_batch
from tests.adapters.trained import batch_of, build, saved, sequences

denoiser_table = partial(split_model_table, networks=DenoiserConfiguration, objective=DenoiserObjective)
dart_table = partial(split_model_table, networks=DartConfiguration, objective=DartObjective)
gmd_table = partial(split_model_table, networks=GMDConfiguration, objective=GMDObjective)
wandr_table = partial(split_model_table, networks=WandrConfiguration, objective=WandrObjective)

METHODS = ("mdm", "pr", "gmd", "dart", "wandr")
TURNS = {"dart": (40, 90)}  # a step of each phase


@pytest.mark.parametrize("name", METHODS)
def test_a_step_is_a_function_of_seed_number_and_rank(name):
    module, batch = build(name), batch_of(sequences())
    for step in TURNS.get(name, (7,)):
        first, again, other = (module(batch, number)["loss"] for number in (step, step, step + 1))
        assert torch.equal(first, again)
        assert not torch.equal(first, other)
        for change in ("rank", "seed"):
            setattr(module, change, 1)
            assert not torch.equal(module(batch, step)["loss"], first), change
            setattr(module, change, 0)


@pytest.mark.parametrize("name", METHODS)
def test_whatever_stands_in_padding_leaves_no_trace(name):
    module, batch = build(name), batch_of(sequences())
    valid = ~batch.padding
    spoilt = dataclasses.replace(
        batch,
        joints=torch.where(valid[..., None, None], batch.joints, torch.nan),
        features=torch.where(valid[..., None], batch.features, torch.nan),
    )
    for step in TURNS.get(name, (3,)):
        assert torch.equal(module(batch, step)["loss"], module(spoilt, step)["loss"])


_RECORDED = {
    "vae_stages": [1.0, 0.0, 0.0], "denoiser_stages": [1.0, 0.0, 0.0], "primitives": 1, "text_drop": 0.0,
    "denoiser_delta_weight": 0.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "model", "step", "steps", "rate", "losses", "share", "idle"),
    [
        ("pr", {"text_drop": 0.0}, 0, 60, 5e-3, ["loss"], 0.6, ""),
        ("pr-frames", {}, 0, 40, 5e-3, ["loss"], 0.6, ""),
        ("gmd", {}, 0, 8, 1e-2, ["motion", "trajectory"], 0.9, ""),
        # Without the weight of 1e4 on deltas, which made-up bodies, with bones that change, cannot meet.
        ("dart", _RECORDED, 0, 30, 5e-3, ["reconstruction"], 0.85, "denoiser."),
        ("dart", _RECORDED, 50, 30, 5e-3, ["latent"], 0.85, "vae."),
        # For the same reason their joints cannot be met; their changes can.
        ("wandr", {"joint_loss_weight": 0.0, "longest_chunk": 1}, 0, 60, 1e-2, ["changes"], 0.6, ""),
    ],
)
def test_every_weight_learns_and_the_losses_of_one_batch_fall(name, model, step, steps, rate, losses, share, idle):
    module, batch = build(name, **model), batch_of(sequences(), 4)
    optimiser = torch.optim.Adam(module.parameters(), lr=rate)
    first = {part: float(value.detach()) for part, value in module(batch, step).items()}
    for turn in range(steps):
        optimiser.zero_grad()
        module(batch, step)["loss"].backward()
        optimiser.step()
        if not turn:
            without = {key for key, value in module.named_parameters() if value.grad is None}
            assert without == {key for key, _ in module.named_parameters() if idle and key.startswith(idle)}
    last = module(batch, step)
    for part in losses:
        assert float(last[part].detach()) < share * first[part], part


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("mdm", {}),
        ("pr", {}),
        ("pr-frames", {}),
        ("gmd", {}),
        ("dart", {"vae_share": 0.0}),
        ("wandr", {"original_deviation": True}),
    ],
)
def test_fine_tuning_goes_on_from_weights_and_keeps_their_statistics(name, model, tmp_path):
    before = build(name, seed=1)
    if name == "dart":
        before(batch_of(sequences()), 50)  # measures the latents
    tensors = before.weights()[0]
    for key in tensors.keys() & {"statistics.mean", "condition.mean", "network.delta.mean"}:
        tensors[key].add_(0.25)
    after = build(name, initial=saved(before, tmp_path / "before.safetensors"), seed=2, **model)
    for key, tensor in tensors.items():
        assert torch.equal(after.weights()[0][key], tensor), key
    assert any(line.startswith("initial weights before.safetensors, sha256 ") for line in after.origin)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("pr", {"width": 32}, r"configuration\.width: expected 32.* --set model\.width=16"),
        ("gmd", {"diffusion_steps": 20}, r"diffusion_steps: expected 20, .* found 10. Add --set model.diff"),
        ("dart", {"layers": 3}, r"configuration\.layers: expected 3.*Add --set model\.layers=2"),
        ("wandr", {"layers": 4}, r"configuration\.layers: expected 4.*Add --set model\.layers=3"),
        ("pr", {"goal": "pose"}, r"configuration\.goal: expected pose.*found location"),
    ],
)
def test_initial_weights_of_another_model_are_refused_with_the_key_to_change(name, change, message, tmp_path):
    path = saved(build(name), tmp_path / "first.safetensors")
    with pytest.raises(InputFileError, match=message):
        build(name, initial=path, **change)


@pytest.mark.parametrize(
    ("name", "model", "message"),
    [
        ("mdm", {"goal": "location"}, "--method mdm .* expected model.goal to be none"),
        ("pr", {"goal": "none"}, "expected model.goal to be pose or location, found 'none'"),
        ("pr", {"widht": 32}, "unknown field `widht`"),
        ("pr", {"uniform_skeleton": True}, r"model.uniform_skeleton: .* HumanML3D"),
        ("mdm", {"text_dimension": 768}, "vectors of 64 numbers, found 768"),
        ("mdm", {"representation": "reference"}, "data.mode: the model expects reference, found continuous"),
        ("mdm", {"max_frames": 100}, "expected at most the model's 100, found 241"),
        ("mdm", {"fps": 30.0}, "the model expects 30.0, found 20.0"),
        ("gmd", {"width": 3}, r"\[model\]: .*unknown field `width`"),
        ("gmd", {"motion_widths": [9]}, r"\[model\]: 'motion_widths' must be .* multiples of 8"),
        ("gmd", {"text_dimension": 63}, "model.text_dimension: the text encoder 'hashed-ngrams' has vectors of 64"),
        ("gmd", {"max_frames": 59}, "data.max_frames: expected at most the model's 59, found 241"),
        ("gmd", {"representation": "reference"}, "data.mode: the model expects reference, found continuous"),
        ("dart", {"windth": 3}, "unknown field"),
        ("dart", {"vae_share": 1.0}, "vae_share"),
        ("dart", {"vae_share": 0.0}, r"vae_share: 0 keeps the VAE of initial weights"),
        ("dart", {"vae_stages": [0.5, 0.5, 0.5]}, "vae_stages"),
        ("dart", {"windows": 0}, "windows"),
        ("dart", {"text_dimension": 65}, r"text_dimension: .* vectors of 64 numbers"),
        ("dart", {"fps": 30.0}, "expects 30, found 20"),
        ("dart", {"future_frames": 300}, "a motion primitive takes 302 frames"),
        ("wandr", {"width": 3}, "unknown field"),
        ("wandr", {"layers": "x"}, "layers"),
        ("wandr", {"free_bits": -1.0}, "free_bits"),
        ("wandr", {"pseudo_goals": 2.0}, "pseudo_goals"),
    ],
)
def test_what_does_not_fit_together_is_refused(name, model, message):
    with pytest.raises(UsageError, match=message):
        build(name, **model)


@pytest.mark.parametrize(("name", "stopped_after"), [("pr", 3), ("gmd", 3), ("dart", 2), ("dart", 4), ("wandr", 3)])
def test_a_stopped_training_goes_on_to_the_same_bits(name, stopped_after, tmp_path):
    settings = OptimisationConfiguration(steps=6, learning_rate=1e-3, ema=0.9, save_every=9, log_every=1)
    configuration, data = TrainingConfiguration(model={}, training=settings), sequences()

    def bits(out: Path, stop: int | None = None) -> bytes:
        def batches(start: int):
            for step in range(start, 6):
                if step + 1 == stop:
                    signal.raise_signal(signal.SIGTERM)
                yield collate([data[step], data[step + 1]])

        fit(build(name, data), batches, configuration, out)
        return (out / "weights.safetensors").read_bytes()

    with pytest.raises(TrainingStopped):
        bits(tmp_path / "stopped", stopped_after)
    assert bits(tmp_path / "stopped") == bits(tmp_path / "whole")


@pytest.mark.parametrize(
    ("method", "steps", "condition", "options", "logged"),
    [
        ("mdm", None, None, {"sampler": "ddim", "steps": "2"}, {"features", "joints"}),
        ("gmd", 4, Condition.GOAL_POSE, {"steps": "2"}, {"motion", "trajectory"}),
        ("dart", 6, Condition.GOAL_POSE, {"iterations": "1"}, {"latent", "reconstruction"}),
        ("wandr", 5, Condition.GOAL_LOCATION, {}, {"changes", "divergence", "positions", "own_changes"}),
    ],
)
def test_the_smoke_configuration_trains_and_its_weights_generate(
    method, steps, condition, options, logged, tmp_path, monkeypatch
):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    command = ["train", "--method", method, "--config", "smoke", "--data", str(trained.table())]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    card = read_json(tmp_path / "out" / "weights.json")
    assert (card["method"], card["finished"], card["steps"]) == (method, True, steps or card["steps"])
    rows = card["learning_curve"]
    assert logged <= set(rows[-1])
    if method == "dart":
        assert [row["latent"] > 0 for row in rows] == [False] * 3 + [True] * 3
        assert json.dumps(card["learned_from"]).count("hashed-ngrams") == 1
    adapter = load_adapter(method, tmp_path / "out", options, "cpu")
    batch = text_batch([12]) if condition is None else conditions(condition, 1, frames=(12,))
    batch = dataclasses.replace(batch, fps=adapter.native_fps)
    assert np.isfinite(adapter.generate(batch, seed=0).joints).all()


# Configurations that come with the methods.

STAGES = ("pretrain", "finetune")
NAMES = ("paper", "small", "smoke")
TABLES = {"mdm": denoiser_table, "pr": denoiser_table, "gmd": gmd_table, "dart": dart_table, "wandr": wandr_table}
NETWORKS = {
    "mdm": lambda sizes: [network(sizes)],
    "pr": lambda sizes: [network(sizes)],
    "gmd": lambda sizes: [GMDNetworks(sizes)],
    "dart": lambda sizes: [PrimitiveVAE(sizes), LatentDenoiser(sizes)],
    "wandr": lambda sizes: [WandrNetwork(sizes)],
}


def _configuration(method: str, name: str, stage: str) -> TrainingConfiguration:
    return load_configuration(name, package=f"prbench_adapters.{method}", task=method, stage=stage)


def _count(method: str, sizes: object) -> int:
    with torch.device("meta"):
        return sum(value.numel() for made in NETWORKS[method](sizes) for value in made.parameters())


@pytest.mark.parametrize("method", METHODS)
def test_a_method_is_trainable_by_its_one_line(method):
    assert method in list_tasks()
    task = load_task(method)
    assert isinstance(task, TrainingTask)
    assert (task.name, list_configurations(task.configurations, task.name)) == (method, NAMES)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("method", METHODS)
def test_data_and_model_of_a_configuration_fit_together(method, name, stage):
    configuration = _configuration(method, name, stage)
    model, objective = TABLES[method](configuration.model)
    if method in ("mdm", "pr", "gmd"):
        assert configuration.data.max_frames <= model.max_frames
        assert configuration.data.mode == model.representation
        assert objective.text_drop == (0.1 if method == "gmd" else 0.2)
    if method in ("mdm", "pr"):
        assert (model.goal == "none") is (method == "mdm" or (stage == "pretrain" and name != "small"))
    if (method, name, stage) == ("dart", "paper", "pretrain"):  # windows are cropped to exactly what they take
        assert configuration.data.max_frames == 2 + objective.primitives * model.future_frames


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("method", ["mdm", "pr"])
def test_shown_commands_name_the_stage_without_which_a_goal_is_never_learnt(method, name):
    file = resources.files(f"prbench_adapters.{method}").joinpath(f"{method}-{name}.toml")
    for command in re.findall(r"prbench train .*", file.read_text(encoding="utf-8")):
        stage = re.search(r"--stage (\w+)", command)
        assert stage is not None, command
        needs_prior = stage[1] == "finetune" and name != "small"
        assert needs_prior is ("--init" in command), command


@pytest.mark.parametrize("method", METHODS)
def test_every_number_of_a_paper_configuration_names_its_source(method):
    file = resources.files(f"prbench_adapters.{method}").joinpath(f"{method}-paper.toml")
    for line in file.read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition("=")
        bookkeeping = key.strip() in {"mode", "save_every", "log_every", "sequences", "condition"}
        if value and not line.startswith("#") and not bookkeeping:
            sources = ("paper", "choice", "DistilBERT", "MDM" if method == "pr" else method.upper())
            assert any(word in line.partition("#")[2] for word in sources), line


@pytest.mark.parametrize("name", ["paper", "smoke"])
def test_fine_tuning_may_start_from_the_pretrained_model_of_the_same_size(name):
    prior, _ = denoiser_table(_configuration("mdm", name, "pretrain").model)
    tuned, _ = denoiser_table(_configuration("pr", name, "finetune").model)
    also, _ = denoiser_table(_configuration("pr", name, "pretrain").model)
    assert prior == also
    for field in set(DenoiserConfiguration.__struct_fields__) - FREE_TO_CHANGE:
        assert getattr(prior, field) == getattr(tuned, field), field


def test_the_paper_configurations_hold_the_numbers_of_the_study():
    """Prime and Reach, sections 4 and 5.1; docs/specification/pr-model.md#training."""
    pretraining, fine_tuning = _configuration("pr", "paper", "pretrain"), _configuration("pr", "paper", "finetune")
    assert (pretraining.training.learning_rate, pretraining.training.steps) == (1e-4, 600_000)
    assert (fine_tuning.training.learning_rate, fine_tuning.training.steps) == (5e-5, 250_000)
    assert (pretraining.data.crop, fine_tuning.data.crop) == ("random", "end")
    model, objective = denoiser_table(fine_tuning.model)
    expected = DenoiserConfiguration(goal="location", max_frames=241)  # the defaults are the paper's sizes
    assert model == expected
    assert objective == DenoiserObjective(
        joint_loss_weight=1.0, velocity_loss_weight=0.0, bone_loss_weight=0.0, text_drop=0.2
    )
    for configuration in (pretraining, fine_tuning):
        training = configuration.training
        assert (training.batch_size, training.ema, training.schedule) == (64, 0.9999, "constant")
        assert (training.weight_decay, training.betas, training.gradient_clip) == (0.0, (0.9, 0.999), None)
    assert (pretraining.data.max_frames, fine_tuning.data.max_frames) == (150, 241)


@pytest.mark.parametrize("task", ["mdm", "pr"])
def test_the_paper_configurations_cover_the_longest_sequence_of_the_protocol(task):
    protocol = load_protocol()
    longest = round((protocol.curation.priming_window + protocol.curation.lead) * protocol.fps) + 1
    for stage in STAGES:
        assert _configuration(task, "paper", stage).model["max_frames"] == longest
    assert _configuration(task, "paper", "finetune").data.max_frames == longest
    assert _configuration(task, "paper", "pretrain").data.max_frames == 150, "N of the study, for clips of the corpus"


def test_mdm_and_pr_share_the_pretraining_of_the_paper():
    assert _configuration("mdm", "paper", "pretrain").training == _configuration("pr", "paper", "pretrain").training


def test_the_paper_configuration_of_dart_holds_the_numbers_of_the_original():
    """docs/specification/dart.md#networks and docs/specification/dart.md#training."""
    configuration = _configuration("dart", "paper", "pretrain")
    model, objective = dart_table(configuration.model)
    assert model == DartConfiguration()  # the defaults are the original's sizes
    assert objective == DartObjective(vae_batch_size=128, denoiser_stages=(0.3334, 0.3333, 0.3333))  # and its weights
    training = configuration.training
    assert (training.steps, training.batch_size, training.learning_rate) == (500_000, 1024, 1e-4)
    assert (training.ema, training.gradient_clip) == (0.999, 1.0)
    assert round(objective.vae_share * training.steps) == 200_000
    stages = [round(share * 200_000) for share in objective.vae_stages]
    assert stages == [100_000, 50_000, 50_000]


def test_the_paper_configuration_of_gmd_holds_the_numbers_of_the_original():
    """docs/specification/gmd.md#networks."""
    pretraining, fine_tuning = _configuration("gmd", "paper", "pretrain"), _configuration("gmd", "paper", "finetune")
    model, _ = gmd_table(pretraining.model)
    assert (model.diffusion_steps, model.padded_frames, model.emphasis) == (1000, 224, 10.0)
    assert (model.motion_widths, model.trajectory_widths) == ((1024,) * 4, (64, 128, 256))
    assert (pretraining.training.steps, fine_tuning.training.steps) == (500_000, 250_000)
    assert (pretraining.training.batch_size, pretraining.training.ema) == (64, 0.9999)
    assert (pretraining.training.weight_decay, pretraining.training.gradient_clip) == (0.01, 1.0)


@pytest.mark.parametrize(
    ("method", "change"),
    [("mdm", {}), ("pr", {"goal": "location"}), ("pr", {"goal": "pose"}), ("gmd", {}), ("dart", {})],
)
def test_small_networks_fit_the_package_as_float16_and_need_no_download(method, change):
    stage = "pretrain" if method == "mdm" else "finetune"
    model, _ = TABLES[method]({**_configuration(method, "small", stage).model, **change})
    parameters = _count(method, model)
    assert parameters > 0.9e6
    projection = 2 * 263**2 + 40_000 if method == "gmd" else 0
    assert 2 * parameters + projection < 2.5e6  # bytes
    assert model.text_encoder == "hashed-ngrams"


def test_networks_of_wandr_have_their_sizes():
    for name, size in {"paper": 4.15e6, "small": 1.19e6, "smoke": 3.1e4}.items():
        model, _ = wandr_table(_configuration("wandr", name, "finetune").model)
        assert _count("wandr", model) == pytest.approx(size, rel=0.01)
    assert _count("wandr", WandrConfiguration()) == pytest.approx(4.15e6, rel=2e-3)


def test_networks_of_dart_have_the_originals_size():
    """12.4 and 18.0 million with CLIP's 512 numbers a text; the VAE's 500 positions are 12 and 11 here."""
    vae, denoiser = (
        sum(value.numel() for value in made.parameters())
        for made in NETWORKS["dart"](DartConfiguration(text_dimension=512))
    )
    assert vae + (1000 - 12 - 11) * 256 == pytest.approx(12.4e6, rel=0.005)
    assert denoiser == pytest.approx(18.0e6, rel=0.005)


@pytest.mark.parametrize("method", ["mdm", "gmd", "dart", "wandr"])
def test_compared_networks_see_as_many_sequences_as_the_p_and_r_model_does(method):
    own, theirs = (_configuration(each, "small", "finetune") for each in (method, "pr"))
    assert own.data == theirs.data
    for key in ("steps", "batch_size", "learning_rate", "warmup_steps", "ema", "seed"):
        assert getattr(own.training, key) == getattr(theirs.training, key), key


@pytest.mark.parametrize(
    ("name", "steps_before"), [("mdm-small", 0), ("gmd-small", 0), ("dart-small", 20_000), ("wandr-small", 20_000)]
)
def test_bundled_weights_have_seen_as_much_as_those_of_p_and_r(name, steps_before):
    """P&R took 12,000 steps and 8,000 more from there, on people of generator 3.

    DART and WANDR went on, after the 20,000 steps of the others, with people of generator 3.
    """
    theirs, own = (read_json(bundled_weights(each).with_suffix(".json")) for each in ("pr-small-goal-loc", name))
    assert steps_before + own["steps"] >= 12_000 + theirs["steps"]
    assert bool(own["initial_weights_sha256"]) == bool(steps_before)
    if not steps_before:
        assert sum(table["sequences"] for table in own["data"]) >= sum(table["sequences"] for table in theirs["data"])
    for key in ("batch_size", "ema"):
        assert own["configuration"]["training"][key] == theirs["configuration"]["training"][key], key
    assert own["parameters"] == pytest.approx(theirs["parameters"], rel=0.15)  # as many as fit into a file


def test_both_bundled_weights_of_p_and_r_have_seen_the_same():
    cards = [read_json(bundled_weights(f"pr-small-goal-{goal}").with_suffix(".json")) for goal in ("loc", "pose")]
    assert cards[0]["steps"] == cards[1]["steps"]
    digests = [[table["content_digest"] for table in card["data"]] for card in cards]
    assert digests[0] == digests[1]
