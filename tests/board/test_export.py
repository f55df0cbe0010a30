"""A board as Markdown, CSV and JSON: every number with its unit, every remark, and text from files is only text."""

from __future__ import annotations

import itertools
import json
import re

import msgspec
import pytest

from prbench.board import export
from prbench.errors import UsageError
from tests.board.runs import board_of, by_method, cells, csv_rows, leaderboard, metrics, only, printed, write_run

TWO = {"datasets": ("adt", "gimo")}


def test_the_printed_table_holds_the_main_metrics_in_percent_and_metres(tmp_path):
    board = board_of(tmp_path, pr={"prime_success": 0.3542, "goal_mpjpe": 0.0249, "foot_skating": 0.111})
    header, _, row = cells(export(board, "md"))
    assert header[3:] == [
        "Prime Success ↑ (%)", "Reach Success ↑ (%)", "Goal MPJPE ↓ (m)", "Location Error ↓ (%)", "MPJPE ↓ (m)",
        "Foot Skating ↓", "Plausible ↑ (%)", "Plausible (version 3) ↑ (%)",
        "s/motion (declared)", "CPU s/motion (declared)", "Passes/motion (declared)", "Memory (MiB) (declared)",
        "Parameters (declared)", "Kind (declared)",
    ]  # fmt: skip
    assert [row[i] for i in (3, 5, 8)] == ["35.42 [31.88, 38.96]", "0.02 [0.02, 0.03]", "0.11 [0.10, 0.12]"]


def test_synthetic_data_are_called_so(tmp_path):
    board = board_of(tmp_path, pr={})
    text = export(board, "md")
    assert re.search(r"^## .*\(synthetic\), synthetic-adt: test, 80 sequences, 12 recordings$", text, re.M)
    assert "scores on synthetic data" in text
    assert all("synthetic" in row["note"] for row in csv_rows(board))
    assert json.loads(export(board, "json"))["tables"][0]["synthetic"] is True


def test_a_body_that_stands_still_has_a_dash_for_foot_skating_everywhere(tmp_path):
    board = board_of(
        tmp_path,
        still={"about": {"motionless": True}, **TWO, "foot_skating": 0.0},
        pr={**TWO, "foot_skating": 0.2},
    )
    shown = printed(board, "adt title")
    assert shown["still"][8] == "–"
    assert shown["pr"][8].startswith("0.20")  # and is not best of one
    assert printed(board, "Mean over")["still"][8] == "–"
    rows = [row for row in csv_rows(board) if row["metric"] == "foot_skating"]
    assert {row["value"] for row in rows if row["method"] == "still"} == {""}


@pytest.mark.parametrize("low", [None, 0.1])
def test_few_recordings_are_marked_and_explained(tmp_path, low):
    marked = tuple(msgspec.structs.replace(m, marks=("few_recordings",), low=low, high=low and 0.9) for m in metrics())
    board = board_of(tmp_path, pr={"summary": {"metrics": marked}})
    assert printed(board)["pr"][3] == ("50.00 [10.00, 90.00] †" if low else "50.00 †")
    assert "- † few recordings" in export(board, "md")


def test_csv_has_one_number_a_row_and_a_unique_key(tmp_path):
    rows = csv_rows(board_of(tmp_path, one={**TWO, "prime_success": 1 / 3}, two=TWO))
    key = ["table", "dataset", "condition", "method", "variant", "metric"]
    assert list(rows[0])[:9] == [*key, "value", "unit", "higher_is_better"]
    assert len({tuple(row[name] for name in key) for row in rows}) == len(rows) == 3 * 2 * 8
    first = next(row for row in rows if row["method"] == "one" and row["metric"] == "prime_success")
    assert (first["value"], first["unit"], first["higher_is_better"]) == ("33.333333", "%", "true")


def test_json_holds_everything_with_rates_from_0_to_1(tmp_path):
    table = only(json.loads(export(board_of(tmp_path, one={"prime_success": 1 / 3}), "json"))["tables"])
    row = only(table["rows"])
    assert (row["record"]["method"]["name"], row["summary"]["sequences"], table["split"]) == ("one", 80, "test")
    assert next(m["mean"] for m in row["summary"]["metrics"] if m["metric"] == "prime_success") == pytest.approx(1 / 3)


HOSTILE = "=cmd|'/c x'!A0 [x](javascript:y) <img src=x onerror=z>\n`\x1b[2J"


def test_names_in_an_export_are_text_and_nothing_else(tmp_path):
    board = board_of(tmp_path, a={"method": HOSTILE, "summary": {"title": HOSTILE}})
    markdown = export(board, "md")
    for markup in ("<img", "[x](", "\x1b"):
        assert markup not in markdown
    assert len({line.replace(r"\|", "").count("|") for line in markdown.splitlines() if line.startswith("| ")}) == 1
    for row in csv_rows(board):
        assert row["method"].startswith("'=cmd")
        assert "\x1b" not in row["method"]


def test_every_table_line_has_the_same_number_of_cells(tmp_path):
    options = {"options": {"note": "a|b\nc"}}
    text = export(
        board_of(tmp_path, one={"method": "one|two", "about": options, **TWO}, two={"datasets": ("adt",)}), "md"
    )
    for heading in ("adt title", "gimo title", "Mean over"):
        assert len({len(row) for row in cells(text, heading)}) == 1
    assert r"| one\|two |" in text
    for before, line in itertools.pairwise(text.splitlines()):
        if line.startswith("|") and not before.startswith("|"):
            assert before == ""  # a table needs an empty line before it


def test_the_order_of_the_paths_and_naming_a_run_twice_change_nothing(tmp_path):
    a, b = write_run(tmp_path / "a", "one"), write_run(tmp_path / "b", "two")
    assert export(leaderboard(b, a, a, tmp_path), "json") == export(leaderboard(a, b), "json")


def test_an_unknown_format_is_an_error(tmp_path):
    with pytest.raises(UsageError, match=r"unknown format 'html'; known ones are: md, csv, json"):
        export(board_of(tmp_path, pr={}), "html")


def test_recorded_motion_that_was_handed_in_is_marked_and_never_ranked(tmp_path):
    copies = tuple(
        msgspec.structs.replace(one, flags={"recorded_motion": 80} if one.metric == "mpjpe" else {})
        for one in metrics(prime_success=0.9)
    )
    board = board_of(
        tmp_path, one={"prime_success": 0.4}, two={"prime_success": 0.3}, copy={"summary": {"metrics": copies}}
    )
    rows = by_method(board)
    assert rows["copy"].ranks == {}
    assert rows["one"].ranks["prime_success"] == 1
    text = export(board, "md")
    assert "| copy †† |" in text
    assert "- copy †† equals the recorded motion in 80 of 80 motions; never ranked." in text
    assert "**90.00**" not in text
    notes = {row["method"]: row["note"] for row in csv_rows(board)}
    assert "†† equals the recorded motion in 80 of 80 motions" in notes["copy"]
    assert "††" not in notes["one"]
    listed = only(json.loads(export(board, "json"))["tables"])["rows"]
    marks = {row["record"]["method"]["name"]: row["mark"] for row in listed}
    assert marks["copy"].startswith("††")
    assert marks["one"] == ""
