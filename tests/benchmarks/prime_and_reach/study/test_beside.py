"""Published numbers beside measured ones: which runs may stand there, differences, intervals, escaping."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import msgspec
import pytest

from prbench.board import collect_runs, export, make_leaderboard
from prbench.harness.verification import CheckedSummary
from prbench.protocol.published import load_published, load_table_one
from prbench_benchmarks.prime_and_reach.study.beside import (
    add_published,
    differences,
    published_variant,
    why_not_beside,
)
from tests.board.test_tables import as_stored, by_means, write_run

REAL = {"synthetic": False, "title": "Aria Digital Twin"}


def write_real(folder, method="pr", *, dataset="adt", condition="goal-loc", weights="pr-goal-loc.safetensors", **more):
    """A finished run of a built-in method on real recordings."""
    write_run(
        folder,
        method,
        kind="built-in",
        datasets=(dataset,),
        sequences=more.pop("sequences", load_table_one()[dataset].test),
        record={"condition": condition, **more.pop("record", {})},
        table={"synthetic": False, **more.pop("table", {})},
        summary={**REAL, "condition": condition, **more.pop("summary", {})},
        **more,
    )
    record = json.loads((folder / "run.json").read_text())
    record["method"]["weights"] = weights
    (folder / "run.json").write_text(json.dumps(record))
    return folder


def board_of(path):
    return make_leaderboard(collect_runs([path], check=as_stored), separate=by_means)


def rows_of(path):
    return [row for table in board_of(path).tables for row in table.rows]


def test_a_run_on_the_study_s_test_split_stands_beside_its_row(tmp_path):
    write_real(tmp_path / "a", prime_success=0.40)
    found = {one.metric: one for one in differences(rows_of(tmp_path))}
    assert set(found) == {number.metric for number in load_published("2")}
    prime = found["prime_success"]
    assert (prime.measured, prime.published) == (pytest.approx(40.0), 52.08)
    assert prime.difference == pytest.approx(40.0 - 52.08)
    assert prime.unit == "%"
    assert prime.published_variant == "fine-tuned"
    assert prime.remarks == ()
    assert prime.assumptions == ("rate", "ray", "onset")
    assert prime.source == "published: Prime and Reach, Table 2 (section 5.4)"


def test_the_interval_of_a_rate_is_wider_than_the_measured_one(tmp_path):
    """Both intervals count: squares of the distances to their bounds add up."""
    write_real(tmp_path / "a", prime_success=0.40)
    prime = next(one for one in differences(rows_of(tmp_path)) if one.metric == "prime_success")
    # Measured 40 [36, 44]; Wilson's interval of 44/85 is [41.30, 62.07], and 52.08 is the printed number.
    assert prime.low == pytest.approx(-12.08 - (4.0**2 + (62.07 - 52.08) ** 2) ** 0.5, abs=0.02)
    assert prime.high == pytest.approx(-12.08 + (4.0**2 + (52.08 - 41.30) ** 2) ** 0.5, abs=0.02)


def test_a_published_length_counts_as_exact(tmp_path):
    write_real(tmp_path / "a", mpjpe=0.5)
    mpjpe = next(one for one in differences(rows_of(tmp_path)) if one.metric == "mpjpe")
    assert (mpjpe.low, mpjpe.high) == (pytest.approx(0.45 - 0.61), pytest.approx(0.55 - 0.61))


def test_another_number_of_sequences_is_said(tmp_path):
    write_real(tmp_path / "a", sequences=60)
    assert "60 test sequences, the study has 85" in differences(rows_of(tmp_path))[0].remarks


@pytest.mark.parametrize(
    ("weights", "said"),
    [
        ("pr-small-goal-loc.safetensors", "small bundled weights"),
        ("mine.safetensors", "what its weights were trained on is not known"),
    ],
)
def test_other_weights_than_the_study_s_are_said(tmp_path, weights, said):
    write_real(tmp_path / "a", weights=weights)
    assert any(remark.startswith(said) for remark in differences(rows_of(tmp_path))[0].remarks)


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
    ],
)
def test_no_published_number_stands_beside_what_does_not_compare(tmp_path, change):
    write_real(tmp_path / "a", **change)
    assert differences(rows_of(tmp_path)) == ()


def test_no_published_number_stands_beside_a_run_of_one_s_own_protocol(tmp_path):
    write_real(tmp_path / "a")
    (row,) = rows_of(tmp_path)
    assert differences([row])
    entry = replace(row.entry, protocol="mine 1")
    assert differences([replace(row, entry=entry)]) == ()
    assert why_not_beside(entry) == "a protocol of the user's own, mine 1"


def test_a_run_stands_beside_published_numbers_once_where_there_are_common_sequences(tmp_path):
    write_real(tmp_path / "a", table={"unsupported": 3}, summary={"unsupported": 3})
    write_real(tmp_path / "b")
    brief, whole = sorted(rows_of(tmp_path), key=lambda row: -row.entry.table.unsupported)
    common = frozenset({"some"})
    rows = [replace(row, entry=replace(row.entry, only=common)) for row in (brief, whole)]
    assert differences(rows[1:]) == ()
    assert "3 sequences are left out, as longer than the method can generate" in differences(rows)[0].remarks


def test_a_foreign_method_has_no_published_number(tmp_path):
    folder = write_real(tmp_path / "a")
    record = json.loads((folder / "run.json").read_text())
    record["method"] |= {"kind": "package", "name": "mine"}
    (folder / "run.json").write_text(json.dumps(record))
    assert differences(rows_of(tmp_path)) == ()


def test_unverified_scores_stay_so_beside_published_ones(tmp_path):
    write_real(tmp_path / "a")

    def unverified(run, table):
        return CheckedSummary(as_stored(run, table).summary, "its table is not at hand")

    rows = make_leaderboard(collect_runs([tmp_path], check=unverified)).tables[0].rows
    found = differences(rows)
    assert not any(one.verified for one in found)
    assert all("unverified: its table is not at hand" in one.remarks for one in found)


def test_synthetic_runs_see_no_published_number_at_all(tmp_path):
    write_run(tmp_path / "a", "pr", kind="built-in", record={"condition": "goal-loc"})
    board = board_of(tmp_path)
    text = add_published(export(board, "md"), board, "md")
    assert "None is shown: no table of real recordings" in text
    assert "52.08" not in text
    assert add_published(export(board, "csv"), board, "csv") == export(board, "csv")
    content = json.loads(add_published(export(board, "json"), board, "json"))
    assert content["published"] == []
    assert "synthetic data" in content["not_beside_published"][0]


def test_published_rows_stand_in_a_part_of_their_own(tmp_path):
    write_real(tmp_path / "a", prime_success=0.4)
    board = board_of(tmp_path)
    measured = export(board, "md")
    text = add_published(measured, board, "md")
    assert text.startswith(measured)
    behind = text[len(measured) :]
    assert "published in Prime and Reach, Table 2, not measured here" in behind
    assert "-12.08 [" in behind
    assert "onset: By equation 3" in behind


def test_the_csv_keeps_its_columns_and_says_where_a_number_is_from(tmp_path):
    write_real(tmp_path / "a")
    board = board_of(tmp_path)
    rows = list(csv.DictReader(io.StringIO(add_published(export(board, "csv"), board, "csv"))))
    kinds = {row["kind"] for row in rows}
    assert {
        "built in",
        "published: Prime and Reach, Table 2 (section 5.4)",
        "measured - published (fine-tuned)",
    } == kinds
    published = [row for row in rows if row["table"] == "published 2"]
    assert len(published) == 18 * 6
    assert all(None not in row for row in rows)


def test_names_are_escaped_in_every_format(tmp_path):
    write_real(tmp_path / "a", weights="=cmd|'x'!A0 \x1b[31m<b>.safetensors")
    board = board_of(tmp_path)
    text = add_published(export(board, "md"), board, "md")
    assert "\x1b" not in text
    assert "<b>" not in text
    rows = csv.DictReader(io.StringIO(add_published(export(board, "csv"), board, "csv")))
    assert not any(cell.startswith(("=", "+", "@")) for row in rows for cell in row.values())


def test_the_json_report_has_its_documented_shape(tmp_path):
    from prbench.board.export import Board
    from prbench_benchmarks.prime_and_reach.study.beside import Difference

    write_real(tmp_path / "a")
    board = board_of(tmp_path)
    content = msgspec.json.decode(add_published(export(board, "json"), board, "json"))
    assert len(msgspec.convert(content["published"], list[Difference])) == 6
    assert "onset" in content["assumptions"]
    assert len(msgspec.convert(content, Board).tables) == 1
