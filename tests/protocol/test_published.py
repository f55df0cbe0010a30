"""The study's numbers, typed again: complete, consistent with one another, and cited."""

from __future__ import annotations

from collections import Counter

import pytest

from prbench.metrics import METRICS
from prbench.protocol.published import (
    DATASETS,
    assumptions_for,
    cite,
    load_assumptions,
    load_published,
    load_table_one,
    published_table,
)
from prbench_benchmarks.prime_and_reach.table_two.request import load_table_two

SCORES = {"2": 540, "3": 56, "4": 24, "S1": 48, "S3": 540, "S4": 16, "S5": 16, "S6": 16, "S7": 40, "S8": 12}
METRIC_IDS = {info.id for info in METRICS}


@pytest.mark.parametrize(("table", "cells"), SCORES.items())
def test_a_table_has_all_its_cells_once(table, cells):
    numbers = load_published(table)
    assert len(numbers) == cells
    keys = Counter((each.dataset, each.condition, each.method, each.variant, each.metric) for each in numbers)
    assert max(keys.values()) == 1


@pytest.mark.parametrize("table", SCORES)
def test_numbers_have_a_known_metric_and_are_possible(table):
    for number in load_published(table):
        if table != "S8":
            assert number.metric in METRIC_IDS
            assert number.dataset in DATASETS
        if number.value is not None:
            assert 0 <= number.value <= 100


def test_a_dash_is_no_number():
    dashes = [number for number in load_published("2") if number.value is None]
    assert {(number.method, number.metric) for number in dashes} == {("static", "foot_skating")}
    assert len(dashes) == 5


def test_rows_without_fine_tuning_are_the_same_in_tables_2_and_s3():
    def untrained(table):
        return {
            (number.dataset, number.condition, number.method, number.variant, number.metric): number.value
            for number in load_published(table)
            if not number.variant.startswith("fine-tuned")
        }

    assert untrained("2") == untrained("S3")
    assert len(untrained("2")) == 270


def test_the_full_model_is_the_same_in_every_table_of_ablations():
    two = {
        (number.dataset, number.metric): number.value
        for number in load_published("2")
        if (number.method, number.condition) == ("pr", "goal-loc")
    }
    last = {"3": "full", "4": "pre-trained on Nymeria", "S4": "decoder", "S6": "addition", "S7": "50 diffusion steps"}
    for table, variant in last.items():
        found = [number for number in load_published(table) if number.variant == variant]
        assert len(found) == 8
        for number in found:
            assert number.value == two[number.dataset, number.metric], number


def test_every_row_of_table_2_is_published_on_all_five_datasets():
    published = Counter((number.method, number.condition, number.variant) for number in load_published("2"))
    table = load_table_two()
    rows = [(row.method, row.condition.value, table.weights[row.weights].variant) for row in table.rows]
    assert dict(published) == dict.fromkeys(rows, 30)


def test_every_table_is_cited_with_its_section():
    assert cite("S3") == "Prime and Reach, Table S3 (section C)"
    for table in ("1", "S2", *SCORES):
        assert published_table(table).title


def test_an_unknown_table_is_refused():
    with pytest.raises(ValueError, match="no table of scores '9'"):
        load_published("9")
    with pytest.raises(ValueError, match="no table of scores '1'"):
        load_published("1")


def test_every_main_metric_of_the_study_has_an_assumption():
    assert {metric for each in load_assumptions() for metric in each.metrics} <= METRIC_IDS
    for metric in {number.metric for number in load_published("2")}:
        assert assumptions_for((metric,)), metric


def test_table_1_and_s2_agree():
    rows = load_table_one()
    assert sum(row.train for row in rows.values()) == 16695
    assert sum(row.sequences for row in rows.values()) == 23728
    assert all(row.train + row.test == row.sequences for row in rows.values())
    assert tuple(load_table_one()) == DATASETS
