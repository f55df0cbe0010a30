"""The committed training configurations: complete, consistent, and what the study says."""

from __future__ import annotations

import re
from importlib import resources

import pytest

from prbench.protocol.manifests import load_protocol
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.model import network
from prbench_adapters.diffusion.tasks import FREE_TO_CHANGE, read_model_table
from prbench_adapters.diffusion.training import Objective
from prbench_adapters.training.configuration import TrainingConfiguration, list_configurations, load_configuration

PACKAGES = {"mdm": "prbench_adapters.mdm", "pr": "prbench_adapters.pr"}
NAMES = ("paper", "small", "smoke")
STAGES = ("pretrain", "finetune")


def _load(task: str, name: str, stage: str) -> TrainingConfiguration:
    return load_configuration(name, package=PACKAGES[task], task=task, stage=stage)


@pytest.mark.parametrize("task", ["mdm", "pr"])
def test_each_task_has_its_three_sizes(task):
    assert set(list_configurations(PACKAGES[task], task)) == set(NAMES)


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("task", ["mdm", "pr"])
def test_data_and_model_of_a_configuration_fit_together(task, name, stage):
    configuration = _load(task, name, stage)
    model, objective = read_model_table(configuration.model)
    assert configuration.data.max_frames <= model.max_frames
    assert configuration.data.mode == model.representation
    without_goal = task == "mdm" or (stage == "pretrain" and name != "small")
    assert (model.goal == "none") is without_goal
    assert objective.text_drop == 0.2


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("task", ["mdm", "pr"])
def test_shown_commands_name_the_stage_without_which_a_goal_is_never_learnt(task, name):
    text = resources.files(PACKAGES[task]).joinpath(f"{task}-{name}.toml").read_text(encoding="utf-8")
    for command in re.findall(r"prbench train .*", text):
        stage = re.search(r"--stage (\w+)", command)
        assert stage is not None, command
        needs_prior = stage[1] == "finetune" and name != "small"
        assert needs_prior is ("--init" in command), command


@pytest.mark.parametrize("name", ["paper", "smoke"])
def test_fine_tuning_may_start_from_the_pretrained_model_of_the_same_size(name):
    prior, _ = read_model_table(_load("mdm", name, "pretrain").model)
    tuned, _ = read_model_table(_load("pr", name, "finetune").model)
    also, _ = read_model_table(_load("pr", name, "pretrain").model)
    assert prior == also
    for field in set(DenoiserConfiguration.__struct_fields__) - FREE_TO_CHANGE:
        assert getattr(prior, field) == getattr(tuned, field), field


def test_the_paper_configurations_hold_the_numbers_of_the_study():
    """Prime and Reach, sections 4 and 5.1; docs/specification/pr-model.md#training."""
    pretraining, fine_tuning = _load("pr", "paper", "pretrain"), _load("pr", "paper", "finetune")
    assert (pretraining.training.learning_rate, pretraining.training.steps) == (1e-4, 600_000)
    assert (fine_tuning.training.learning_rate, fine_tuning.training.steps) == (5e-5, 250_000)
    assert (pretraining.data.crop, fine_tuning.data.crop) == ("random", "end")
    model, objective = read_model_table(fine_tuning.model)
    expected = DenoiserConfiguration(goal="location", max_frames=241)  # the defaults are the paper's sizes
    assert model == expected
    assert objective == Objective(joint_loss_weight=1.0, velocity_loss_weight=0.0, bone_loss_weight=0.0, text_drop=0.2)
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
        assert _load(task, "paper", stage).model["max_frames"] == longest
    assert _load(task, "paper", "finetune").data.max_frames == longest
    assert _load(task, "paper", "pretrain").data.max_frames == 150, "N of the study, for clips of the corpus"


@pytest.mark.parametrize("task", ["mdm", "pr"])
@pytest.mark.parametrize("stage", STAGES)
def test_mdm_and_pr_share_the_pretraining_of_the_paper(task, stage):
    if stage == "pretrain":
        assert _load("mdm", "paper", stage).training == _load("pr", "paper", stage).training


@pytest.mark.parametrize("goal", ["none", "location", "pose"])
def test_small_models_fit_the_package_as_float16(goal):
    name = ("mdm", "pretrain") if goal == "none" else ("pr", "finetune")
    model, _ = read_model_table({**_load(name[0], "small", name[1]).model, "goal": goal})
    parameters = sum(parameter.numel() for parameter in network(model).parameters())
    assert parameters > 0.9e6
    assert 2 * parameters < 2.5e6  # bytes


def test_the_small_configurations_need_no_download():
    for task, stage in (("mdm", "pretrain"), ("pr", "finetune")):
        assert read_model_table(_load(task, "small", stage).model)[0].text_encoder == "hashed-ngrams"


@pytest.mark.parametrize("task", ["mdm", "pr"])
def test_every_number_of_the_paper_configurations_names_its_source(task):
    sourced = ("paper", "MDM", "choice", "DistilBERT")
    for line in resources.files(PACKAGES[task]).joinpath(f"{task}-paper.toml").read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition("=")
        bookkeeping = key.strip() in {"mode", "save_every", "log_every", "sequences", "condition"}
        if value and not line.startswith("#") and not bookkeeping:
            assert "#" in value, line
            assert any(word in value.split("#")[1] for word in sourced), line
