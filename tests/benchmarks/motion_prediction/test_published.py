"""The study's numbers, typed again: complete, consistent with its rows, and with what its text claims."""

from __future__ import annotations

from collections import Counter

import pytest

from prbench_benchmarks.motion_prediction.study_tables import (
    PUBLISHED_METRICS,
    TABLES,
    load_tables,
    published_scores,
)


@pytest.mark.parametrize(("name", "cells"), [("table_1", 56), ("table_2", 24), ("table_3", 20), ("apd", 4)])
def test_a_table_has_all_its_cells_once(name, cells):
    numbers = published_scores(name)
    assert len(numbers) == cells
    keys = Counter((each["dataset"], each["method"], each["variant"], each["metric"]) for each in numbers)
    assert max(keys.values()) == 1
    assert all(float(each["value"]) > 0 for each in numbers)


@pytest.mark.parametrize("table", TABLES)
def test_every_printed_number_belongs_to_a_row(table):
    rows = {(row.method, row.variant) for row in load_tables().rows if table in row.tables}
    numbers = published_scores(f"table_{table}")
    assert {(each["method"], each["variant"]) for each in numbers} <= rows
    assert {each["metric"] for each in numbers} == set(PUBLISHED_METRICS)


def test_the_gain_over_humanmac_is_the_one_that_the_text_claims():
    ade = {
        each["method"]: float(each["value"])
        for each in published_scores("table_1")
        if (each["dataset"], each["metric"]) == ("mogaze", "ade") and each["variant"] in ("full", "without gaze")
    }
    full = next(
        float(each["value"])
        for each in published_scores("table_1")
        if (each["dataset"], each["metric"], each["variant"]) == ("mogaze", "ade", "full")
    )
    assert 1 - full / ade["humanmac"] == pytest.approx(0.128, abs=0.001)


def test_names_of_rows_are_unique():
    names = [row.name for row in load_tables().rows]
    assert len(set(names)) == len(names)
