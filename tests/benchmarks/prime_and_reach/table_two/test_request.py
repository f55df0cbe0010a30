"""``table_2.toml`` has the study's rows, and says what is wrong with others."""

from __future__ import annotations

import copy
import csv
from importlib import resources

import msgspec
import pytest

from prbench.errors import UsageError
from prbench.protocol.manifests import read_toml
from prbench_benchmarks.prime_and_reach.table_two.request import TableTwo, load_table_two
from tests.benchmarks.prime_and_reach.table_two.conftest import TABLE

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


def test_names_are_fit_for_folders_and_unique(shipped):
    names = [row.name for row in shipped.rows]
    assert len(set(names)) == len(names) == 18
    assert "goal-pose-dno-finetuned" in names
    assert all(name.replace("-", "").isalnum() for name in names)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table["rows"].append(table["rows"][0]), "stands there 2 times"),
        (lambda table: table["rows"][0].update(weights="mean-pose"), "Did you mean 'mean-training-pose'"),
        (lambda table: table["rows"][0].update(condition="goal-pose"), "which has no block"),
        (lambda table: table["rows"][0].update(condition="goals"), "Invalid enum value 'goals'"),
        (lambda table: table["rows"][0].update(wieghts="x"), "unknown field `wieghts`"),
        (lambda table: table["weights"].update(spare=table["weights"]["mean-training-pose"]), "no row has 'spare'"),
        (lambda table: table["weights"]["mean-training-pose"].update(state="tuned"), "Invalid enum value 'tuned'"),
        (lambda table: table["blocks"].append(table["blocks"][0]), "more than one"),
    ],
)
def test_a_table_that_does_not_hold_together_is_refused(change, message):
    table = copy.deepcopy(TABLE)
    change(table)
    with pytest.raises(msgspec.ValidationError, match=message):
        msgspec.convert(table, TableTwo)


def test_rows_are_chosen_by_method_or_condition():
    table = load_table_two()  # the made-up one
    assert len(table.chosen(None, None)) == 6
    assert [row.label for row in table.chosen("reacher", None)] == ["Reacher †", "Reacher"]
    assert [row.label for row in table.chosen(None, table.blocks[1].condition)] == ["Breaker", "Stranger"]
    with pytest.raises(UsageError, match="Did you mean 'reacher'"):
        table.chosen("reachr", None)
