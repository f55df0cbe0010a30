"""``table_2.toml`` has the study's rows."""

from __future__ import annotations

import csv
from importlib import resources

import pytest

from prbench.errors import UsageError
from prbench.protocol.manifests import read_toml
from prbench_benchmarks.prime_and_reach.table_two.request import TableTwo, load_table_two

PRINTED = {
    "none": ["Static"],
    "text": ["MDM ‡", "MDM *", "MDM"],
    "goal-pose": ["GMD †", "GMD", "DNO †", "DNO", "DartControl †", "DartControl", "P&R"],
    "goal-loc": ["WANDR †", "WANDR", "DNO †", "DNO", "DartControl †", "DartControl", "P&R"],
}


@pytest.fixture
def shipped() -> TableTwo:
    return read_toml("prbench_benchmarks.prime_and_reach", "table_2.toml", TableTwo)


def test_the_rows_are_the_printed_ones_in_the_printed_order(shipped):
    assert [block.condition.value for block in shipped.blocks] == list(PRINTED)
    for condition, labels in PRINTED.items():
        assert [row.label for row in shipped.rows if row.condition == condition] == labels
    assert [row.condition.value for row in shipped.rows] == [name for name, rows in PRINTED.items() for _ in rows]


def test_marks_and_weights_agree(shipped):
    for row in shipped.rows:
        weights = shipped.weights[row.weights]
        zero_shot = row.label[-1] in "†‡*"
        assert zero_shot == (weights.state == "pretrained")
        assert (weights.trained_on == "all") == (weights.state != "pretrained")
    assert shipped.weights["mdm-humanml3d"].trained_on == "humanml3d"  # ‡
    assert shipped.weights["mdm-nymeria"].trained_on == "nymeria"  # *


def test_every_number_of_the_published_table_has_a_row(shipped, samples):
    path = samples.parent / "methods" / "paper-tables" / "pr_table_2.csv"
    if not path.is_file():
        pytest.skip(f"the published numbers are not there: {path}")
    ids = {"Static": "static", "MDM": "mdm", "GMD": "gmd", "DNO": "dno", "DartControl": "dart", "WANDR": "wandr"}
    conditions = {"initial state + goal pose": "goal-pose", "initial state + object location": "goal-loc"}
    with path.open(encoding="utf-8") as file:
        published = dict.fromkeys(
            (conditions.get(row["condition"], row["condition"]), ids.get(row["method"], "pr"), row["variant"])
            for row in csv.DictReader(file)
        )
    ours = [(row.condition.value, row.method, shipped.weights[row.weights].variant) for row in shipped.rows]
    assert ours == list(published)


def test_bundled_weights_of_the_methods_that_have_some_are_there(shipped):
    files = resources.files("prbench_adapters")
    homes = {"mdm": "mdm", "dno": "mdm", "pr": "pr"}
    for row in shipped.rows:
        if row.method in homes and row.bundled:
            assert (files / homes[row.method] / "weights" / f"{row.bundled}.safetensors").is_file(), row.bundled


def test_rows_have_blocks_weights_and_names_that_fit_folders(shipped):
    conditions = [block.condition for block in shipped.blocks]
    assert sorted(conditions) == sorted(set(conditions))
    assert {row.condition for row in shipped.rows} == set(conditions)
    assert {row.weights for row in shipped.rows} == set(shipped.weights)
    names = [row.name for row in shipped.rows]
    assert len(set(names)) == len(names) == 18
    assert "goal-pose-dno-finetuned" in names
    assert all(name.replace("-", "").isalnum() for name in names)


def test_rows_are_chosen_by_method_or_condition():
    table = load_table_two()  # the made-up one
    assert len(table.chosen(None, None)) == 6
    assert [row.label for row in table.chosen("reacher", None)] == ["Reacher †", "Reacher"]
    assert [row.label for row in table.chosen(None, table.blocks[1].condition)] == ["Breaker", "Stranger"]
    with pytest.raises(UsageError, match="Did you mean 'reacher'"):
        table.chosen("reachr", None)
