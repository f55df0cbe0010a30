"""Runs side by side: what is compared, ranked and separated."""

from __future__ import annotations

import re

import msgspec
import numpy as np
import pytest

import prbench
from prbench.board import collect_runs, compare_runs, export, make_leaderboard
from prbench.board.comparison import separate_by_comparison, sequence_scores
from prbench.board.tables import FEWEST_RANKED, of_all_methods
from prbench.harness.prime_and_reach import PRIME_AND_REACH
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.scores import read_scores
from tests.board.runs import as_stored, board_of, by_method, csv_rows, leaderboard, metrics, only, printed, write_run
from tests.fakes import fake_dataset
from tests.harness.run_folder.test_record import METHOD

CONTROL = {"about": {"kind": "control"}}
TWO = {"datasets": ("adt", "gimo")}


def test_two_runs_stand_in_one_table_by_condition_with_controls_last(tmp_path):
    board = board_of(
        tmp_path, a={"method": "ground-truth", **CONTROL}, pr={"record": {"condition": "goal-loc"}}, static={}
    )
    assert list(by_method(board)) == ["static", "pr", "ground-truth"]


def test_ranks_follow_the_direction_of_each_metric_within_a_condition(tmp_path):
    board = board_of(
        tmp_path,
        one={"prime_success": 0.6, "mpjpe": 0.3, "location_error": 0.1},
        two={"prime_success": 0.4, "mpjpe": 0.2, "location_error": 0.1},
        three={"prime_success": 0.9, "record": {"condition": "goal-loc"}},
        control={"method": "ground-truth", "prime_success": 1.0, "mpjpe": 0.0, **CONTROL},
        shuffled={"method": "one", "record": {"control": "shuffled-goal"}, "prime_success": 1.0},
    )
    ranks = {(row.entry.method, row.variant): row.ranks for row in only(board.tables).rows}
    one, two = ranks["one", ""], ranks["two", ""]
    assert (one["prime_success"], two["prime_success"]) == (1, 2)
    assert (one["mpjpe"], two["mpjpe"]) == (2, 1)
    assert (one["location_error"], two["location_error"]) == (1, 1)
    assert ranks["three", ""] == ranks["ground-truth", ""] == ranks["one", "shuffled-goal"] == {}
    text = export(board, "md")
    assert re.search(r"\| one \|  \| \*\*60\.00\*\* ", text)
    assert re.search(r"\| two \|  \| 40\.00 ", text)


@pytest.mark.parametrize(("sequences", "ranked"), [(49, False), (50, True)])
def test_nothing_is_ranked_below_fifty_sequences(tmp_path, sequences, ranked):
    board = board_of(
        tmp_path,
        one={"sequences": sequences, "prime_success": 0.6},
        two={"sequences": sequences, "prime_success": 0.4},
    )
    assert any(row.ranks for row in only(board.tables).rows) is ranked
    text = export(board, "md")
    assert ("**" in text) is ranked
    assert ("Nothing is ranked: fewer than 50" in text) is not ranked


def test_a_method_that_left_sequences_out_stands_in_no_table_of_all_sequences(tmp_path):
    # These summaries follow from no scores, so that there is nothing to make a common table from.
    board = board_of(
        tmp_path,
        one={"prime_success": 0.6, "summary": {"unsupported": 5}},
        two={"prime_success": 0.4},
        three={"prime_success": 0.3},
    )
    found = [{row.entry.method: row.ranks.get("prime_success") for row in table.rows} for table in board.tables]
    assert found == [{"two": 1, "three": 2}, {"one": None}]
    assert "one: 5 sequences are longer than it can generate" in export(board, "md")


@pytest.fixture
def long_and_short(tmp_path):
    """A table, the length of each of its sequences, the third longest length, and a function that scores motions."""
    table = fake_dataset(tmp_path / "table", 240, recordings=40)
    scalars = table.scalars(split="test")
    lengths = dict(zip(*(scalars[name].to_pylist() for name in ("sequence_id", "n_frames"))))
    limit = sorted(lengths.values())[-3]

    def score(method, most, offset):
        """Score a body that stays as it begins, ``offset(length)`` metres off; ``most`` is its longest motion."""
        motions = {}
        for chunk in table.chunks(split="test", columns=["joints"]):
            for name, start, length in zip(chunk.sequence_ids, chunk.offsets, chunk.n_frames):
                if most is None or length <= most:
                    motions[name] = np.repeat(chunk.joints[start : start + 1] + offset(length), length, axis=0)
        out = tmp_path / "runs" / method
        prbench.score(motions, table.folder, name=method, condition="text", max_frames=most, out=out)

    return table, lengths, limit, score


def test_ranks_on_common_sequences_follow_from_these_alone(tmp_path, long_and_short):
    _, lengths, limit, score = long_and_short
    # "one" and "two" differ on the long sequences only, where "one" is out by metres.
    score("one", None, lambda length: 5.0 if length > limit else 0.0)
    score("two", None, lambda length: 0.0)
    score("brief", limit, lambda length: 0.0)
    seen = []

    def separate(rows, metrics):
        seen.append({row.method: row.only for row in rows})
        return separate_by_comparison(rows, metrics)

    _, common = make_leaderboard(collect_runs([tmp_path / "runs"]), separate=separate).tables
    assert {"one": common.common, "two": common.common, "brief": common.common} in seen
    assert {"one": None, "two": None} in seen
    assert {row.entry.method: row.ranks["mpjpe"] for row in common.rows} == {"one": 1, "two": 1, "brief": 1}
    files = (tmp_path / "runs" / name / "synthetic-adt/scores.parquet" for name in ("one", "two"))
    record = common.rows[0].entry.table
    first, second = (sequence_scores(file, PRIME_AND_REACH, record, only=common.common)["mpjpe"] for file in files)
    assert set(first[0]) == {name for name, length in lengths.items() if length <= limit}
    assert np.array_equal(first[2], second[2])
    assert of_all_methods(make_leaderboard(collect_runs([tmp_path / "runs"])).tables)[0].common == common.common


def test_all_methods_are_scored_on_the_sequences_that_every_one_generated(tmp_path, long_and_short):
    table, lengths, limit, score = long_and_short
    short = {name for name, length in lengths.items() if length <= limit}
    assert FEWEST_RANKED <= len(short) < len(lengths)
    run_method(RunRequest(method="scripted", data=(table.folder,), out=tmp_path / "runs" / "truth"))
    score("whole", None, lambda length: 0.5)
    score("brief", limit, lambda length: 0.0)
    board = make_leaderboard(collect_runs([tmp_path / "runs"]))
    whole, common = board.tables
    assert [row.entry.method for row in whole.rows] == ["whole", "scripted"]
    assert {row.entry.method for row in common.rows} == {"whole", "brief", "scripted"}
    assert (whole.sequences, whole.of) == (len(lengths), 0)
    assert (common.sequences, common.of, common.common) == (len(short), len(lengths), short)
    assert common.shortest == (f"brief ({len(lengths) - len(short)})",)
    ranks = {row.entry.method: row.ranks.get("mpjpe") for row in common.rows}
    assert ranks == {"whole": 2, "brief": 1, "scripted": None}
    for row in common.rows:
        scores = read_scores(tmp_path / "runs" / row.entry.run / "synthetic-adt/scores.parquet").to_pylist()
        values = [one["value"] for one in scores if one["metric"] == "mpjpe" and one["sequence_id"] in short]
        assert row.entry.summary.metric("mpjpe").mean == pytest.approx(sum(values) / len(values))
        assert row.entry.summary.metric("mpjpe").sequences == len(short)
    text = export(board, "md")
    assert f"{len(short)} sequences, " in text
    assert f"of {len(lengths)} that every method here generated" in text
    compared = compare_runs(tmp_path / "runs" / "whole", tmp_path / "runs" / "brief")
    assert compared.left_out == (
        f"{table.info.dataset}: compared on the {len(short)} of {len(lengths)} sequences that both methods generated",
    )
    assert {row.comparison.difference.n_sequences for row in compared.metrics} == {len(short)}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"record": {"protocol_digest": "e" * 64}}, "protocol"),
        ({"table": {"identity_digest": "e" * 64}}, "table identity"),
        ({"table": {"content_digest": "e" * 64}}, "table content"),
        ({"record": {"split": "train"}}, "split"),
        ({"table": {"selection_digest": "e" * 64}}, "chosen sequences"),
    ],
)
def test_runs_that_do_not_compare_are_kept_apart_and_the_reason_is_given(tmp_path, changes, reason):
    board = board_of(tmp_path, one={"prime_success": 0.6}, two={"prime_success": 0.4, **changes})
    assert len(board.tables) == 2
    assert all(len(table.rows) == 1 and not table.rows[0].ranks for table in board.tables)
    assert board.notes == (f"synthetic-adt has 2 tables that must not be compared: they differ in {reason}.",)
    headings = re.findall(r"^## synthetic-adt title.*$", export(board, "md"), re.M)
    assert len(set(headings)) == 2
    assert {row["table"] for row in csv_rows(board)} == {"1", "2"}


def test_runs_of_an_earlier_protocol_stand_apart_under_its_version(tmp_path):
    earlier = {"record": {"protocol_version": 1, "protocol_digest": "e" * 64}}
    board = board_of(tmp_path, old={**TWO, **earlier}, new=TWO)
    text = export(board, "md")
    # Two datasets and their mean, each once under version 1 and once under the present one.
    assert len(re.findall(r"^## .*protocol version 1", text, re.M)) == 3
    assert len(re.findall(r"^## (?!Notes)", text, re.M)) == 6
    assert text.count("Scored under version 1 of the protocol; version 4 is the present one") == 2
    notes = {row["method"]: row["note"] for row in csv_rows(board)}
    assert "protocol version 1" in notes["old"]
    assert "protocol version" not in notes["new"]


def test_the_macro_mean_weighs_datasets_alike_and_needs_all_of_them(tmp_path):
    board = board_of(
        tmp_path,
        a={"method": "one", "datasets": ("adt",), "prime_success": 0.2},
        b={"method": "one", "datasets": ("gimo",), "prime_success": 0.6, "sequences": 1000},
        two={**TWO, "prime_success": 0.3},
        three={"datasets": ("adt",), "prime_success": 0.9},
    )
    assert len(board.tables) == 2
    rows = {row.method: row for row in only(board.macro).rows}
    assert rows["one"].means["prime_success"].mean == pytest.approx(0.4)
    assert rows["two"].means["prime_success"].mean == pytest.approx(0.3)
    assert (rows["three"].means, rows["three"].missing, rows["three"].ranks) == ({}, ("gimo",), {})
    # "two" is better on adt and "one" on gimo, so their means separate no methods.
    assert (rows["one"].ranks["prime_success"], rows["two"].ranks["prime_success"]) == (1, 1)
    shown = printed(board, "Mean over")
    assert shown["one"][3] == "40.00 [36.84, 43.16] (1)"
    assert shown["three"][3:-1] == [""] * 8 + ["gimo"]


def test_no_macro_mean_over_tables_that_do_not_compare(tmp_path):
    board = board_of(tmp_path, one=TWO, two={"datasets": ("adt",), "table": {"content_digest": "e" * 64}})
    assert board.macro == ()


def test_a_method_that_is_better_on_every_dataset_is_better_in_the_mean(tmp_path):
    board = board_of(tmp_path, one={**TWO, "prime_success": 0.2}, two={**TWO, "prime_success": 0.3})
    rows = {row.method: row for row in only(board.macro).rows}
    assert (rows["one"].ranks["prime_success"], rows["two"].ranks["prime_success"]) == (2, 1)


def test_methods_of_one_name_and_two_kinds_are_two_rows_of_the_mean(tmp_path):
    for kind in ("package", "program"):
        write_run(tmp_path / kind, "glide", **TWO, about={"kind": kind, "package": "x"})
    rows = only(leaderboard(tmp_path).macro).rows
    assert sorted(row.origin for row in rows) == ["package x 1", "program x"]
    assert all(row.missing == () for row in rows)


def test_plausible_stands_in_the_table_and_ranks_nobody(tmp_path):
    board = board_of(
        tmp_path,
        one={**TWO, "plausible": 1.0, "reach_success": 0.2},
        two={**TWO, "plausible": 0.1, "reach_success": 0.3},
    )
    ranks = {row.entry.method: row.ranks for row in board.tables[0].rows}
    assert (ranks["one"]["reach_success"], ranks["two"]["reach_success"]) == (2, 1)
    assert "plausible" not in ranks["one"]
    assert "plausible" not in only(board.macro).rows[0].ranks
    shown = printed(board, "adt title")
    assert shown["one"][9].startswith("100.00")  # printed, and not bold
    assert shown["two"][4].startswith("**30.00**")


def test_a_run_from_before_a_metric_has_an_empty_cell_and_no_rank_by_it(tmp_path):
    old = tuple(metric for metric in metrics() if metric.metric not in ("reach_success", "plausible"))
    board = board_of(tmp_path, old={"summary": {"metrics": old}}, new={}, newer={})
    ranked = {name: "reach_success" in row.ranks for name, row in by_method(board).items()}
    assert ranked == {"new": True, "newer": True, "old": False}
    assert [printed(board)["old"][i] for i in (4, 9)] == ["", ""]


def test_variants_tell_runs_of_one_method_apart(tmp_path):
    for name, changes in (
        ("a", {"about": {"options": {"steps": "10"}}}),
        ("b", {"about": {"options": {"steps": "50"}}}),
        ("c", {}),
        ("d", {"record": {"seed": 1}}),
        ("e", {"record": {"seed": 1, "threads": 4}}),
    ):
        write_run(tmp_path / name, "one", **changes)
    variants = [row.variant for row in only(leaderboard(tmp_path).tables).rows]
    assert sorted(variants) == ["run d", "run e", "seed 0", "steps=10", "steps=50"]


def test_variants_tell_runs_of_one_control_apart_although_they_share_a_block(tmp_path):
    for name, condition in (("a", "none"), ("b", "goal-loc"), ("c", "goal-loc")):
        write_run(tmp_path / name, "scripted", record={"condition": condition}, **CONTROL)
    variants = [row.variant for row in only(leaderboard(tmp_path).tables).rows]
    assert variants == ["condition none", "run b", "run c"]


def test_a_single_motion_that_equals_the_recorded_one_is_shown_and_may_be_an_accident(tmp_path):
    one = tuple(
        msgspec.structs.replace(m, flags={"recorded_motion": 1} if m.metric == "mpjpe" else {}) for m in metrics()
    )
    board = board_of(tmp_path, one={"sequences": 200}, two={"sequences": 200, "summary": {"metrics": one}})
    row = by_method(board)["two"]
    assert row.entry.summary.mark == "†† equals the recorded motion in 1 of 200 motions"
    assert row.ranks["prime_success"] == 1


def test_methods_that_the_data_do_not_separate_share_a_rank_and_no_winner_is_bold(tmp_path):
    for name, mean in (("one", 0.29), ("two", 0.19), ("three", 0.1)):
        write_run(tmp_path / name, name, prime_success=mean)

    def separate(rows, metrics):
        place = {row.method: i for i, row in enumerate(rows)}
        return {(place["three"], "prime_success"): frozenset({place["one"]})} if rows else {}

    board = make_leaderboard(collect_runs([tmp_path], check=as_stored), separate=separate)
    rows = by_method(board)
    assert [rows[name].ranks["prime_success"] for name in ("one", "two", "three")] == [1, 1, 2]
    assert not any(row.leads for row in rows.values())
    text = export(board, "md")
    assert "**" not in text
    assert "Prime Success: 1. one, two; 2. three (methods of one group are not separated)" in text
    assert re.search(r"the data separate no two methods in .*Reach Success", text)


@pytest.mark.parametrize(("recordings", "sequences", "reason"), [(3, 300, "3 recordings"), (11, 22, "22 sequences")])
def test_a_dataset_that_cannot_be_decided_says_so(tmp_path, recordings, sequences, reason):
    given = {"sequences": sequences, "summary": {"recordings": recordings}}
    board = board_of(tmp_path, one=given, two=given)
    assert f"synthetic-adt cannot be decided: {reason}" in export(board, "md")
    assert any(reason in line for line in msgspec.json.decode(export(board, "json"))["tables"][0]["undecided"])


def test_the_smallest_detectable_difference_stands_below_the_table(tmp_path):
    known = {"prime_success": 0.27, "mpjpe": 0.034, "reach_success": 1.3}
    entries = tuple(msgspec.structs.replace(entry, detectable=known.get(entry.metric)) for entry in metrics())
    board = board_of(tmp_path, one={"summary": {"metrics": entries}})
    text = export(board, "md")
    for line in ("Prime Success 27 points", "Reach Success none (not even 100 points)", "MPJPE 0.034 m"):
        assert line in text
    found = {row["metric"]: row["detectable"] for row in csv_rows(board) if row["detectable"]}
    assert found == {"prime_success": "27", "reach_success": "130", "mpjpe": "0.034"}


@pytest.mark.parametrize("kind", ["package", "program", "file"])
def test_a_foreign_method_under_a_name_of_prbenchs_is_left_out_with_the_reason(tmp_path, kind):
    board = board_of(tmp_path, static={}, b={"method": "ground-truth", "about": {"kind": kind}})
    assert list(by_method(board)) == ["static"]
    assert only(board.notes).startswith("Left out: b: 'ground-truth' is a control of prbench")


def test_every_export_says_whose_a_method_is(tmp_path):
    foreign = {"name": "glide", "kind": "package", "package": "glider", "isolation": "bubblewrap"}
    board = board_of(
        tmp_path,
        pr={},
        glide={"record": {"method": msgspec.structs.replace(METHOD, **foreign)}},
        forged={"about": {"kind": "built-in"}},
        truth={"method": "ground-truth", **CONTROL},
    )
    kinds = {method: row[-1] for method, row in printed(board).items()}
    assert kinds == {
        "pr": "built in, prbench 1",
        "glide": "package glider 1, isolated: bubblewrap",
        "forged": "unknown kind",
        "ground-truth": "control, prbench 1",
    }
    assert {row["method"]: row["kind"] for row in csv_rows(board)} == kinds
    rows = only(msgspec.json.decode(export(board, "json"))["tables"])["rows"]
    assert {row["record"]["method"]["name"]: row["origin"] for row in rows} == kinds
