"""Tables 3, 4 and S4 to S7: every row becomes a model that trains and generates, and knows its published numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.generation import SamplingSettings, generate
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.training import Objective
from prbench_adapters.pr import load, training_task
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.ablations import Ablation, load_ablations
from prbench_adapters.training.configuration import load_configuration
from prbench_adapters.training.task import TrainingData, split_model_table
from prbench_adapters.training.weights import write_weights
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.goal_batches import conditions
from tests.fakes import fake_dataset

ROWS = load_ablations()
BY_NAME = {row.name: row for row in ROWS}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SequenceDataset:
    folder = tmp_path_factory.mktemp("ablations")
    return SequenceDataset([fake_dataset(folder / "table", n=8)], max_frames=60, cache=folder / "cache")


def test_the_tables_have_all_their_rows_and_no_row_comes_twice():
    counts = {table: sum(row.table == table for row in ROWS) for table in dict.fromkeys(row.table for row in ROWS)}
    assert counts == {"3": 7, "4": 3, "S4": 2, "S5": 2, "S6": 2, "S7": 5}
    assert len(BY_NAME) == len(ROWS)


def test_every_row_knows_its_published_numbers_as_shares():
    for row in ROWS:
        published = row.published()
        assert set(published) == {"hd-epic", "mogaze"}
        for numbers in published.values():
            assert set(numbers) == {"prime_success", "reach_success", "location_error", "mpjpe"}
            assert all(0.0 < value <= 1.0 for value in numbers.values())
    (full,) = (row for row in ROWS if (row.table, row.variant) == ("3", "full"))
    assert list(full.published()["mogaze"].values()) == pytest.approx([0.6237, 1.0, 0.3643, 0.56])


def test_rows_that_change_nothing_are_one_training():
    """The study prints the full model in every table; it is trained once."""
    same = {row.training_name for row in ROWS if row.model == {"goal": "location"} and row.pretraining == "nymeria"}
    assert len(same) == 1
    assert len({row.training_name for row in ROWS}) == 15


@pytest.mark.parametrize("name", BY_NAME)
def test_every_row_trains_a_step_and_generates_at_its_smoke_size(name, data, tmp_path):
    row = BY_NAME[name]
    module = _module(row, data, tmp_path)
    losses = module(collate([data[0], data[1]]), 0)
    losses["loss"].backward()
    assert torch.isfinite(losses["loss"])
    model = MotionModel(module.denoiser, mean=module.mean, std=module.std, scaling=module.scaling, texts=module.texts)
    few = SamplingSettings(guidance=1.0, sampler="ddim", steps=5)
    motions = generate(model, conditions(Condition.GOAL_LOCATION, 2), few)
    assert np.isfinite(motions.ragged()).all()


def _module(row: Ablation, data: SequenceDataset, folder: Path):
    """The row's model at smoke size, fine-tuned from a prior if it has one."""
    smoke = load_configuration("smoke", package="prbench_adapters.pr", task="pr", stage="finetune").model
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    initial = None
    if row.pretraining != "none":
        prior = training_task().build(
            {**smoke, "goal": "none", **row.pretrained_model}, data=given, initial=None, stage="pretrain"
        )
        initial = folder / "prior.safetensors"
        write_weights(initial, *prior.weights(), {})
    return training_task().build({**smoke, **row.model}, data=given, initial=initial, stage="finetune")


@pytest.mark.parametrize("name", BY_NAME)
def test_every_row_changes_what_its_table_is_about(name):
    paper = load_configuration("paper", package="prbench_adapters.pr", task="pr", stage="finetune").model
    own, base = (
        split_model_table({**paper, **change}, DenoiserConfiguration, Objective) for change in (BY_NAME[name].model, {})
    )
    differing = {
        field
        for ours, theirs in zip(own, base, strict=True)
        for field in ours.__struct_fields__
        if getattr(ours, field) != getattr(theirs, field)
    }
    allowed = {
        "3": "dropped",
        "S4": "architecture",
        "S5": "joint_loss_weight",
        "S6": "injection",
        "S7": "diffusion_steps",
    }
    assert differing <= {allowed.get(BY_NAME[name].table)}


def test_every_run_has_options_that_the_adapter_takes(tmp_path):
    weights = tiny.write(tmp_path / "weights.safetensors", goal="location")
    for options in {tuple(row.options.items()) for row in ROWS}:
        load(weights, options=dict(options), device="cpu")
