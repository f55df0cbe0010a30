"""Configurations: files, stages and single keys, in that order, and no key that nobody reads."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from prbench.errors import InputFileError, UsageError
from prbench_adapters.training.configuration import as_toml, list_configurations, load_configuration, resolve

PACKAGE = "tests.adapters.training.configurations"


def load(*overrides, stage="pretrain", name="small"):
    return load_configuration(name, package=PACKAGE, task="toy", stage=stage, overrides=overrides)


def test_a_stage_overrides_the_file_and_a_single_key_overrides_both():
    assert load().training.learning_rate == 1e-2
    assert load(stage="finetune").training.learning_rate == 5e-3
    assert load(("training.learning_rate", "1e-3"), stage="finetune").training.learning_rate == 1e-3
    assert load(stage="finetune").training.steps == 8, "what a stage does not name stays"
    assert (load().model, load(stage="finetune").model) == ({"width": 6}, {"width": 7})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("true", True),
        ("pose", "pose"),
        ('"pose"', "pose"),
        ('["goal", "text"]', ["goal", "text"]),
        ("a=b", "a=b"),
    ],
)
def test_values_need_no_quotes_on_the_command_line(text, value):
    assert load(("model.anything", text)).model["anything"] == value


def test_the_printed_configuration_is_one_that_can_be_read_back(tmp_path):
    configuration = load(("model.dropped", '["goal"]'), ("model.nested.key", "1"), ("validation.sequences", "9"))
    file = tmp_path / "own.toml"
    file.write_text(as_toml(configuration))
    assert load(name=str(file)) == configuration
    assert resolve(tomllib.loads(as_toml(configuration)), source=Path("x"), stage="finetune") == configuration


def test_a_name_may_be_given_with_or_without_that_of_the_task():
    assert list_configurations(PACKAGE, "toy") == ("small",)
    assert load(name="toy-small") == load(name="small")


def test_a_wrong_name_lists_those_that_exist():
    with pytest.raises(
        UsageError, match=r"'toy' has no configuration 'smal'. Did you mean 'small'\? There are: small;"
    ):
        load(name="smal")


@pytest.mark.parametrize(
    ("key", "value", "error", "message"),
    [
        ("trainin.steps", "5", UsageError, "a table of model, training, data, validation, found 'trainin.steps'"),
        ("steps", "5", UsageError, "a table of"),
        ("training.a b", "5", UsageError, "--set training.a b=5"),
        ("training.step", "5", InputFileError, "unknown field `step`"),
        ("training.steps", "many", InputFileError, r"training.steps: .* found Expected `int`, got `str`"),
        ("training.steps", "0", InputFileError, "'steps' must be at least 1"),
        (
            "training.warmup_steps",
            "9",
            InputFileError,
            "9 `warmup_steps`.* 8 `steps`; .*training.warmup_steps=0",
        ),
        ("validation.patience", "2", InputFileError, "`patience` is 2, but `every` is 0"),
        ("training.ema", "1.0", InputFileError, "'ema' must be at least 0 and below 1"),
        ("training.learning_rate", "0", InputFileError, "'learning_rate' must be above 0"),
        ("training.gradient_clip", "-1", InputFileError, "`gradient_clip` must be above 0"),
        ("data.crop", "middle", InputFileError, "Invalid enum value 'middle'"),
    ],
)
def test_a_key_or_value_that_does_not_fit_is_named(key, value, error, message):
    with pytest.raises(error, match=message):
        load((key, value))
