"""The study's numbers, typed again: complete, consistent with its rows, and with what its text claims."""

from __future__ import annotations

from collections import Counter

import pytest

from prbench_benchmarks.motion_prediction.published_numbers import (
    PUBLISHED_DATASETS,
    PUBLISHED_METRICS,
    TABLES,
    load_published_scores,
    load_tables,
    published_scores,
)


@pytest.mark.parametrize(("table", "cells"), [("1", 56), ("2", 24), ("3", 20), ("text", 4)])
def test_a_table_has_all_its_cells_once(table, cells):
    numbers = load_published_scores(table)
    assert len(numbers) == cells
    keys = Counter((each.dataset, each.method, each.variant, each.metric) for each in numbers)
    assert max(keys.values()) == 1
    assert all(each.value > 0 for each in numbers)


@pytest.mark.parametrize("table", TABLES)
def test_every_printed_number_belongs_to_a_row(table):
    found = [
        score
        for row in load_tables().of(table)
        for dataset in PUBLISHED_DATASETS
        for score in published_scores(table, row, dataset).values()
    ]
    assert sorted(found, key=repr) == sorted(load_published_scores(table), key=repr)
    assert {score.metric for score in found} == set(PUBLISHED_METRICS)


def test_the_gain_over_humanmac_is_the_one_that_the_text_claims():
    rows = {row.name: row for row in load_tables().of("1")}
    ours = published_scores("1", rows["gazemodiff-pose-gaze"], "mogaze")["ade"].value
    theirs = published_scores("1", rows["humanmac-pose"], "mogaze")["ade"].value
    assert 1 - ours / theirs == pytest.approx(0.128, abs=0.001)


def test_names_of_rows_are_unique():
    names = [row.name for row in load_tables().rows]
    assert len(set(names)) == len(names)


def test_an_unknown_table_is_refused():
    with pytest.raises(ValueError, match="no table '4'"):
        load_published_scores("4")
