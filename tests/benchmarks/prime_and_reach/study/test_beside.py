"""Published numbers beside measured ones: which runs may stand there, differences, intervals, escaping."""

from __future__ import annotations

from dataclasses import replace

import pytest

from prbench.board import collect_runs, make_leaderboard
from prbench.harness.results import CheckedSummary
from prbench.protocol.published import load_published, load_table_one
from prbench_benchmarks.prime_and_reach.study.methods import (
    differences,
    published_variant,
    why_not_beside,
)
from tests.board.runs import as_stored, by_means, write_run

REAL = {"synthetic": False, "title": "Aria Digital Twin"}


def write_real(folder, method="pr", *, dataset="adt", condition="goal-loc", weights="pr-goal-loc.safetensors", **more):
    """A finished run of a built-in method on real recordings."""
    write_run(
        folder,
        method,
        about={"kind": "built-in", "weights": weights, **more.pop("about", {})},
        datasets=(dataset,),
        sequences=more.pop("sequences", load_table_one()[dataset].test),
        record={"condition": condition, **more.pop("record", {})},
        table={"synthetic": False, **more.pop("table", {})},
        summary={**REAL, "condition": condition, **more.pop("summary", {})},
        **more,
    )
    return folder


def board_of(path):
    return make_leaderboard(collect_runs([path], check=as_stored), separate=by_means)


def rows_of(path):
    return [row for table in board_of(path).tables for row in table.rows]


def test_a_run_on_the_study_s_test_split_stands_beside_its_row(tmp_path):
    write_real(tmp_path / "a", prime_success=0.40)
    found = {cell.metric: (cell, remarks) for cell, remarks in differences(rows_of(tmp_path))}
    assert set(found) == {number.metric for number in load_published("2")}
    prime, remarks = found["prime_success"]
    assert prime.value == pytest.approx(40.0 - 52.08)
    assert (prime.unit, prime.variant) == ("%", "fine-tuned")
    assert remarks == ()
    assert prime.note == "assumptions: rate, ray, onset"
    assert prime.origin == "measured - published: Prime and Reach, Table 2 (section 5.4)"


def test_the_interval_of_a_rate_is_wider_than_the_measured_one(tmp_path):
    """Both intervals count: squares of the distances to their bounds add up."""
    write_real(tmp_path / "a", prime_success=0.40)
    prime = next(cell for cell, _ in differences(rows_of(tmp_path)) if cell.metric == "prime_success")
    # Measured 40 [36, 44]; Wilson's interval of 44/85 is [41.30, 62.07], and 52.08 is the printed number.
    assert prime.low == pytest.approx(-12.08 - (4.0**2 + (62.07 - 52.08) ** 2) ** 0.5, abs=0.02)
    assert prime.high == pytest.approx(-12.08 + (4.0**2 + (52.08 - 41.30) ** 2) ** 0.5, abs=0.02)


def test_a_published_length_counts_as_exact(tmp_path):
    write_real(tmp_path / "a", mpjpe=0.5)
    mpjpe = next(cell for cell, _ in differences(rows_of(tmp_path)) if cell.metric == "mpjpe")
    assert (mpjpe.low, mpjpe.high) == (pytest.approx(0.45 - 0.61), pytest.approx(0.55 - 0.61))


def test_another_number_of_sequences_is_said(tmp_path):
    write_real(tmp_path / "a", sequences=60)
    assert "60 test sequences, the study has 85" in differences(rows_of(tmp_path))[0][1]


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        ("pr-small-goal-loc.safetensors", "small bundled weights"),
        ("mine.safetensors", "what its weights were trained on is not known"),
    ],
)
def test_other_weights_than_the_study_s_are_said(tmp_path, weights, said):
    write_real(tmp_path / "a", weights=weights)
    assert any(remark.startswith(said) for remark in differences(rows_of(tmp_path))[0][1])


def test_zero_shot_and_fine_tuned_rows_are_told_apart(tmp_path):
    write_real(tmp_path / "a", "dno", weights="dno-pretrained.safetensors")
    write_real(tmp_path / "b", "dno", weights="dno-finetuned")
    variants = [published_variant(row.entry) for row in rows_of(tmp_path)]
    assert set(variants) == {("fine-tuned", ""), ("zero-shot", "")}


def test_table_s3_takes_weights_of_that_very_dataset_only(tmp_path):
    write_real(tmp_path / "a", weights="pr-goal-loc-adt")
    write_real(tmp_path / "b", weights="pr-goal-loc-gimo")
    variants = [published_variant(row.entry, "S3") for row in rows_of(tmp_path)]
    assert sorted(variants, key=str) == [("fine-tuned per dataset", ""), None]


@pytest.mark.parametrize(
    "change",
    [
        {"summary": {"synthetic": True}, "table": {"synthetic": True}},
        {"record": {"split": "train", "condition": "goal-loc"}, "summary": {"split": "train"}},
        {"record": {"control": "shuffled-goal", "condition": "goal-loc"}},
        {"about": {"kind": "package", "name": "mine"}},
    ],
)
def test_no_published_number_stands_beside_what_does_not_compare(tmp_path, change):
    write_real(tmp_path / "a", **change)
    assert differences(rows_of(tmp_path)) == []


def test_no_published_number_stands_beside_a_run_of_one_s_own_protocol(tmp_path):
    write_real(tmp_path / "a")
    (row,) = rows_of(tmp_path)
    assert differences([row])
    entry = replace(row.entry, protocol="mine 1")
    assert differences([replace(row, entry=entry)]) == []
    assert why_not_beside(entry) == "a protocol of the user's own, mine 1"


def test_a_run_stands_beside_published_numbers_once_where_there_are_common_sequences(tmp_path):
    write_real(tmp_path / "a", table={"unsupported": 3}, summary={"unsupported": 3})
    write_real(tmp_path / "b")
    brief, whole = sorted(rows_of(tmp_path), key=lambda row: -row.entry.table.unsupported)
    common = frozenset({"some"})
    rows = [replace(row, entry=replace(row.entry, only=common)) for row in (brief, whole)]
    assert differences(rows[1:]) == []
    assert "3 sequences are left out, as longer than the method can generate" in differences(rows)[0][1]


def test_unverified_scores_stay_so_beside_published_ones(tmp_path):
    write_real(tmp_path / "a")

    def unverified(run, table):
        return CheckedSummary(as_stored(run, table).summary, "its table is not at hand")

    rows = make_leaderboard(collect_runs([tmp_path], check=unverified)).tables[0].rows
    found = differences(rows)
    assert found
    assert all("unverified: its table is not at hand" in remarks for _, remarks in found)
