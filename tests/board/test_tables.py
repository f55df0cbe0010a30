"""Runs side by side: what is compared, ranked, separated and printed."""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

import prbench
from prbench.board import collect_runs, compare_runs, export, make_leaderboard
from prbench.board.comparison import separate_by_comparison, sequence_scores
from prbench.board.tables import FEWEST_RANKED, of_all_methods
from prbench.errors import RunError, UsageError
from prbench.harness.prime_and_reach import PRIME_AND_REACH
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import RunRecord, TableRecord
from prbench.harness.run_folder.scores import read_scores, write_scores
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary
from prbench.harness.verification import CheckedSummary
from prbench.metrics import METRICS
from prbench_benchmarks.prime_and_reach.study.methods import methods_table
from tests.fakes import fake_dataset
from tests.harness.run_folder.test_record import METHOD, RECORD, SUMMARY, TABLE

UNITS = {info.id: info.unit for info in METRICS}


def metrics(**means: float) -> tuple[MetricSummary, ...]:
    values = {info.id: 0.5 for info in METRICS if info.main} | means
    return tuple(
        MetricSummary(
            metric=info.id,
            title=info.title,
            unit=info.unit,
            mean=values[info.id],
            low=values[info.id] * 0.9,
            high=values[info.id] * 1.1,
            level=0.95,
            interval="bootstrap",
            sequences=80,
            recordings=12,
            marks=(),
            flags={},
        )
        for info in METRICS
        if info.id in values
    )


def write_run(
    folder: Path,
    method: str = "pr",
    *,
    datasets: tuple[str, ...] = ("synthetic-adt",),
    sequences: int = 80,
    kind: str = "adapter",
    motionless: bool = False,
    options: dict[str, str] | None = None,
    record: dict | None = None,
    table: dict | None = None,
    summary: dict | None = None,
    **means: float,
) -> Path:
    """A finished run with the given means."""
    made = msgspec.structs.replace(METHOD, name=method, kind=kind, motionless=motionless, options=options or {})
    tables = tuple(
        msgspec.structs.replace(TABLE, **{"dataset": name, "sequences": sequences, **(table or {})})
        for name in datasets
    )
    run: RunRecord = msgspec.structs.replace(RECORD, **{"method": made, "tables": tables, **(record or {})})
    run.write(folder)
    for name in datasets:
        result: DatasetSummary = msgspec.structs.replace(
            SUMMARY,
            **{
                "dataset": name,
                "title": f"{name} title (synthetic)",
                "method": method,
                "sequences": sequences,
                "recordings": 12,
                "metrics": metrics(**means),
                **(summary or {}),
            },
        )
        path = folder / name
        result.write(path)
        write_scores(path / "scores.parquet", ())
        (path / "cost.json").write_bytes(b"")
    return folder


def leaderboard(*folders: Path):
    """A board of summaries without scores, as if the data supported every difference of means."""
    return make_leaderboard(collect_runs(folders, check=as_stored), separate=by_means)


def by_means(rows, metrics):
    beaten = {}
    for i, row in enumerate(rows):
        for info in metrics:
            sign = 1 if info.higher_is_better else -1
            own = row.metric(info.id)
            others = {j: other.metric(info.id) for j, other in enumerate(rows)}
            if own is None:
                continue
            beaten[i, info.id] = frozenset(
                j for j, found in others.items() if found is not None and sign * found.mean > sign * own.mean
            )
    return beaten


def as_stored(run: RunFolder, table: TableRecord) -> CheckedSummary:
    """Summaries that follow from no scores are taken as they are."""
    return CheckedSummary(DatasetSummary.read(run.dataset(table.dataset).path), "")


def only(items):
    (item,) = items
    return item


def cells(markdown: str, heading: str) -> list[list[str]]:
    block = markdown.split(f"## {heading}")[1].split("\n## ")[0]
    lines = [line for line in block.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


def test_two_runs_stand_in_one_table_by_condition_with_controls_last(tmp_path):
    write_run(tmp_path / "a", "ground-truth", kind="control")
    write_run(tmp_path / "b", "pr", record={"condition": "goal-loc"})
    write_run(tmp_path / "c", "static")
    table = only(leaderboard(tmp_path).tables)
    assert [row.entry.method for row in table.rows] == ["static", "pr", "ground-truth"]


def test_the_printed_table_holds_the_main_metrics_in_percent_and_metres(tmp_path):
    write_run(tmp_path / "a", prime_success=0.3542, goal_mpjpe=0.0249, foot_skating=0.111)
    text = export(leaderboard(tmp_path), "md")
    header, _, row = cells(text, "synthetic-adt title")
    assert header[3:] == [
        "Prime Success ↑ (%)",
        "Prime Success (arrival) ↑ (%)",
        "Reach Success ↑ (%)",
        "Goal MPJPE ↓ (m)",
        "Location Error ↓ (%)",
        "MPJPE ↓ (m)",
        "Foot Skating ↓",
        "Plausible ↑ (%)",
        "s/motion",
        "Passes/motion",
        "Memory (MiB)",
        "Parameters",
        "Kind",
    ]
    assert row[3] == "35.42 [31.88, 38.96]"
    assert row[6] == "0.02 [0.02, 0.03]"
    assert row[9] == "0.11 [0.10, 0.12]"


def test_synthetic_data_are_called_so(tmp_path):
    write_run(tmp_path / "a")
    board = leaderboard(tmp_path)
    assert re.search(
        r"^## .*\(synthetic\), synthetic-adt: test, 80 sequences, 12 recordings$", export(board, "md"), re.M
    )
    assert "scores on synthetic data" in export(board, "md")
    assert all("synthetic" in row["note"] for row in csv.DictReader(io.StringIO(export(board, "csv"))))
    assert json.loads(export(board, "json"))["tables"][0]["synthetic"] is True


def test_a_body_that_stands_still_has_a_dash_for_foot_skating_everywhere(tmp_path):
    write_run(tmp_path / "a", "still", motionless=True, datasets=("adt", "gimo"), foot_skating=0.0)
    write_run(tmp_path / "b", "pr", datasets=("adt", "gimo"), foot_skating=0.2)
    board = leaderboard(tmp_path)
    text = export(board, "md")
    by_method = {row[1]: row for row in cells(text, "adt title")[2:]}
    assert by_method["still"][9] == "–"
    assert by_method["pr"][9].startswith("0.20")  # and is not best of one
    assert {row[1]: row[9] for row in cells(text, "Mean over")[2:]}["still"] == "–"
    rows = [row for row in csv.DictReader(io.StringIO(export(board, "csv"))) if row["metric"] == "foot_skating"]
    assert {row["value"] for row in rows if row["method"] == "still"} == {""}


@pytest.mark.parametrize("low", [None, 0.1])
def test_few_recordings_are_marked_and_explained(tmp_path, low):
    marked = tuple(msgspec.structs.replace(m, marks=("few_recordings",), low=low, high=low and 0.9) for m in metrics())
    write_run(tmp_path / "a", summary={"metrics": marked})
    text = export(leaderboard(tmp_path), "md")
    assert cells(text, "synthetic-adt title")[2][3] == ("50.00 [10.00, 90.00] †" if low else "50.00 †")
    assert "- † few recordings" in text


def test_ranks_follow_the_direction_of_each_metric_within_a_condition(tmp_path):
    write_run(tmp_path / "a", "one", prime_success=0.6, mpjpe=0.3, location_error=0.1)
    write_run(tmp_path / "b", "two", prime_success=0.4, mpjpe=0.2, location_error=0.1)
    write_run(tmp_path / "c", "three", prime_success=0.9, record={"condition": "goal-loc"})
    write_run(tmp_path / "d", "ground-truth", kind="control", prime_success=1.0, mpjpe=0.0)
    write_run(tmp_path / "e", "one", record={"control": "shuffled-goal"}, prime_success=1.0)
    ranks = {(row.entry.method, row.variant): row.ranks for row in only(leaderboard(tmp_path).tables).rows}
    assert ranks["one", ""]["prime_success"] == 1
    assert ranks["two", ""]["prime_success"] == 2
    assert (ranks["one", ""]["mpjpe"], ranks["two", ""]["mpjpe"]) == (2, 1)
    assert (ranks["one", ""]["location_error"], ranks["two", ""]["location_error"]) == (1, 1)
    assert ranks["three", ""] == ranks["ground-truth", ""] == ranks["one", "shuffled-goal"] == {}
    text = export(leaderboard(tmp_path), "md")
    by_row = {(row[1], row[2]): row for row in cells(text, "synthetic-adt title")[2:]}
    assert by_row["one", ""][3].startswith("**60.00** ")
    assert by_row["two", ""][3].startswith("40.00 ")


@pytest.mark.parametrize(("sequences", "ranked"), [(49, False), (50, True)])
def test_nothing_is_ranked_below_fifty_sequences(tmp_path, sequences, ranked):
    write_run(tmp_path / "a", "one", sequences=sequences, prime_success=0.6)
    write_run(tmp_path / "b", "two", sequences=sequences, prime_success=0.4)
    board = leaderboard(tmp_path)
    assert any(row.ranks for row in only(board.tables).rows) is ranked
    assert ("**" in export(board, "md")) is ranked
    assert ("Nothing is ranked: fewer than 50" in export(board, "md")) is not ranked


def test_a_method_that_left_sequences_out_stands_in_no_table_of_all_sequences(tmp_path):
    write_run(tmp_path / "a", "one", prime_success=0.6, summary={"unsupported": 5})
    write_run(tmp_path / "b", "two", prime_success=0.4)
    write_run(tmp_path / "c", "three", prime_success=0.3)
    # These summaries follow from no scores, so that there is nothing to make a common table from.
    found = [
        {row.entry.method: row.ranks.get("prime_success") for row in table.rows}
        for table in leaderboard(tmp_path).tables
    ]
    assert found == [{"two": 1, "three": 2}, {"one": None}]
    assert "one: 5 sequences are longer than it can generate" in export(leaderboard(tmp_path), "md")


def test_ranks_on_common_sequences_follow_from_these_alone(tmp_path):
    table = fake_dataset(tmp_path / "table", 240, recordings=32)
    lengths = dict(zip(*(table.scalars(split="test")[name].to_pylist() for name in ("sequence_id", "n_frames"))))
    limit = sorted(lengths.values())[-3]
    for method, most in (("one", None), ("two", None), ("brief", limit)):
        motions = {}
        for chunk in table.chunks(split="test", columns=["joints"]):
            for name, start, length in zip(chunk.sequence_ids, chunk.offsets, chunk.n_frames):
                # "one" and "two" differ on the long sequences only, where "one" is out by metres.
                off = 5.0 if method == "one" and length > limit else 0.0
                if most is None or length <= most:
                    motions[name] = np.repeat(chunk.joints[start : start + 1] + off, length, axis=0)
        prbench.score(
            motions, table.folder, name=method, condition="text", max_frames=most, out=tmp_path / "runs" / method
        )
    seen = []

    def separate(rows, metrics):
        seen.append({row.method: row.only for row in rows})
        return separate_by_comparison(rows, metrics)

    _, common = make_leaderboard(collect_runs([tmp_path / "runs"]), separate=separate).tables
    assert {"one": common.common, "two": common.common, "brief": common.common} in seen
    assert {"one": None, "two": None} in seen
    assert {row.entry.method: row.ranks["mpjpe"] for row in common.rows} == {"one": 1, "two": 1, "brief": 1}
    short = {name for name, length in lengths.items() if length <= limit}
    scores = {
        name: sequence_scores(
            tmp_path / "runs" / name / "synthetic-adt/scores.parquet", PRIME_AND_REACH, only=common.common
        )
        for name in ("one", "two")
    }
    assert set(scores["one"]["mpjpe"][0]) == short
    assert np.array_equal(scores["one"]["mpjpe"][1], scores["two"]["mpjpe"][1])
    assert of_all_methods(make_leaderboard(collect_runs([tmp_path / "runs"])).tables)[0].common == common.common


def test_all_methods_are_scored_on_the_sequences_that_every_one_generated(tmp_path):
    table = fake_dataset(tmp_path / "table", 240, recordings=32)
    lengths = dict(zip(*(table.scalars(split="test")[name].to_pylist() for name in ("sequence_id", "n_frames"))))
    limit = sorted(lengths.values())[-3]
    short = {name for name, length in lengths.items() if length <= limit}
    assert FEWEST_RANKED <= len(short) < len(lengths)
    run_method(RunRequest(method="scripted", data=(table.folder,), out=tmp_path / "runs" / "truth"))
    for method, most in (("whole", None), ("brief", limit)):
        chunks = list(table.chunks(split="test", columns=["joints"]))
        motions = {
            name: np.repeat(chunk.joints[start : start + 1] + (0.5 if method == "whole" else 0.0), length, axis=0)
            for chunk in chunks
            for name, start, length in zip(chunk.sequence_ids, chunk.offsets, chunk.n_frames)
            if most is None or length <= most
        }
        prbench.score(
            motions, table.folder, name=method, condition="text", max_frames=most, out=tmp_path / "runs" / method
        )
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
        assert row.entry.metric("mpjpe").mean == pytest.approx(sum(values) / len(values))
        assert row.entry.metric("mpjpe").sequences == len(short)
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
    write_run(tmp_path / "a", "one", prime_success=0.6)
    write_run(tmp_path / "b", "two", prime_success=0.4, **changes)
    board = leaderboard(tmp_path)
    assert len(board.tables) == 2
    assert all(len(table.rows) == 1 and not table.rows[0].ranks for table in board.tables)
    assert board.notes == (f"synthetic-adt has 2 tables that must not be compared: they differ in {reason}.",)
    headings = re.findall(r"^## synthetic-adt title.*$", export(board, "md"), re.M)
    assert len(set(headings)) == 2
    assert {row["table"] for row in csv.DictReader(io.StringIO(export(board, "csv")))} == {"1", "2"}


def test_runs_of_an_earlier_protocol_stand_apart_under_its_version(tmp_path):
    earlier = {"record": {"protocol_version": 1, "protocol_digest": "e" * 64}}
    for name, changes in (("old", earlier), ("new", {})):
        write_run(tmp_path / name, name, datasets=("adt", "gimo"), prime_success=0.6, **changes)
    text = export(leaderboard(tmp_path), "md")
    # Two datasets and their mean, each once under version 1 and once under the present one.
    assert len(re.findall(r"^## .*protocol version 1", text, re.M)) == 3
    assert len(re.findall(r"^## ", text, re.M)) - len(re.findall(r"^## Notes", text, re.M)) == 6
    assert text.count("Scored under version 1 of the protocol; version 2 is the present one") == 2
    notes = {row["method"]: row["note"] for row in csv.DictReader(io.StringIO(export(leaderboard(tmp_path), "csv")))}
    assert "protocol version 1" in notes["old"]
    assert "protocol version" not in notes["new"]


def test_the_macro_mean_weighs_datasets_alike_and_needs_all_of_them(tmp_path):
    write_run(tmp_path / "a", "one", datasets=("adt",), prime_success=0.2)
    write_run(tmp_path / "b", "one", datasets=("gimo",), prime_success=0.6, sequences=1000)
    write_run(tmp_path / "c", "two", datasets=("adt", "gimo"), prime_success=0.3)
    write_run(tmp_path / "d", "three", datasets=("adt",), prime_success=0.9)
    board = leaderboard(tmp_path)
    assert len(board.tables) == 2
    rows = {row.method: row for row in only(board.macro).rows}
    assert rows["one"].means["prime_success"].mean == pytest.approx(0.4)
    assert rows["two"].means["prime_success"].mean == pytest.approx(0.3)
    assert rows["three"].means == {}
    assert rows["three"].missing == ("gimo",)
    # "two" is better on adt and "one" on gimo: the means alone, which made ranks 1 and 2 here, separate no methods.
    assert (rows["one"].ranks["prime_success"], rows["two"].ranks["prime_success"]) == (1, 1)
    assert rows["three"].ranks == {}
    printed = {row[1]: row for row in cells(export(board, "md"), "Mean over")[2:]}
    assert printed["one"][3] == "40.00 [36.84, 43.16] (1)"
    assert printed["three"][3:-1] == [""] * 8 + ["gimo"]


def test_no_macro_mean_over_tables_that_do_not_compare(tmp_path):
    write_run(tmp_path / "a", "one", datasets=("adt", "gimo"))
    write_run(tmp_path / "b", "two", datasets=("adt",), table={"content_digest": "e" * 64})
    assert leaderboard(tmp_path).macro == ()


def test_plausible_stands_in_the_table_and_ranks_nobody(tmp_path):
    write_run(tmp_path / "a", "one", datasets=("adt", "gimo"), plausible=1.0, prime_success_arrival=0.2)
    write_run(tmp_path / "b", "two", datasets=("adt", "gimo"), plausible=0.1, prime_success_arrival=0.3)
    board = leaderboard(tmp_path)
    ranks = {row.entry.method: row.ranks for row in board.tables[0].rows}
    assert (ranks["one"]["prime_success_arrival"], ranks["two"]["prime_success_arrival"]) == (2, 1)
    assert "plausible" not in ranks["one"]
    assert "plausible" not in only(board.macro).rows[0].ranks
    by_method = {row[1]: row for row in cells(export(board, "md"), "adt title")[2:]}
    assert by_method["one"][10].startswith("100.00")  # printed, and not bold
    assert by_method["two"][4].startswith("**30.00**")


def test_a_run_from_before_a_metric_has_an_empty_cell_and_no_rank_by_it(tmp_path):
    old = tuple(metric for metric in metrics() if metric.metric not in ("prime_success_arrival", "plausible"))
    write_run(tmp_path / "a", "old", summary={"metrics": old})
    write_run(tmp_path / "b", "new")
    write_run(tmp_path / "c", "newer")
    table = only(leaderboard(tmp_path).tables)
    assert {row.entry.method: "prime_success_arrival" in row.ranks for row in table.rows} == {
        "new": True,
        "newer": True,
        "old": False,
    }
    by_method = {row[1]: row for row in cells(export(leaderboard(tmp_path), "md"), "synthetic-adt title")[2:]}
    assert (by_method["old"][4], by_method["old"][10]) == ("", "")


def test_variants_tell_runs_of_one_method_apart(tmp_path):
    write_run(tmp_path / "a", "one", options={"steps": "10"})
    write_run(tmp_path / "b", "one", options={"steps": "50"})
    write_run(tmp_path / "c", "one")
    write_run(tmp_path / "d", "one", record={"seed": 1})
    write_run(tmp_path / "e", "one", record={"seed": 1, "threads": 4})
    variants = [row.variant for row in only(leaderboard(tmp_path).tables).rows]
    assert sorted(variants) == ["run d", "run e", "seed 0", "steps=10", "steps=50"]


def test_variants_tell_runs_of_one_control_apart_although_they_share_a_block(tmp_path):
    for name, condition in (("a", "none"), ("b", "goal-loc"), ("c", "goal-loc")):
        write_run(tmp_path / name, "scripted", kind="control", record={"condition": condition})
    variants = [row.variant for row in only(leaderboard(tmp_path).tables).rows]
    assert variants == ["condition none", "run b", "run c"]


def test_csv_has_one_number_a_row_and_a_unique_key(tmp_path):
    write_run(tmp_path / "a", "one", datasets=("adt", "gimo"), prime_success=1 / 3)
    write_run(tmp_path / "b", "two", datasets=("adt", "gimo"))
    text = export(leaderboard(tmp_path), "csv")
    assert "\r" not in text
    rows = list(csv.DictReader(io.StringIO(text)))
    key = ("table", "dataset", "condition", "method", "variant", "metric")
    assert list(rows[0])[:9] == [*key, "value", "unit", "higher_is_better"]
    assert len({tuple(row[name] for name in key) for row in rows}) == len(rows) == 3 * 2 * 8
    first = next(row for row in rows if row["method"] == "one" and row["metric"] == "prime_success")
    assert (first["value"], first["unit"], first["higher_is_better"]) == ("33.333333", "%", "true")
    assert all(float(row["value"]) >= 0 for row in rows)


def test_json_holds_everything_with_rates_from_0_to_1(tmp_path):
    write_run(tmp_path / "a", "one", prime_success=1 / 3)
    table = only(json.loads(export(leaderboard(tmp_path), "json"))["tables"])
    row = only(table["rows"])
    assert (row["record"]["method"]["name"], row["summary"]["sequences"], table["split"]) == ("one", 80, "test")
    assert next(m["mean"] for m in row["summary"]["metrics"] if m["metric"] == "prime_success") == pytest.approx(1 / 3)


def test_text_from_a_run_cannot_break_the_table(tmp_path):
    write_run(tmp_path / "a", "one|two", options={"note": "a|b\nc"})
    rows = cells(export(leaderboard(tmp_path), "md"), "synthetic-adt title")
    assert {len(row) for row in rows} == {16}
    assert rows[2][1] == r"one\|two"


HOSTILE = "=cmd|'/c x'!A0 [x](javascript:y) <img src=x onerror=z>\n`\x1b[2J"


def test_names_in_an_export_are_text_and_nothing_else(tmp_path):
    write_run(tmp_path / "a", HOSTILE, summary={"title": HOSTILE})
    markdown = export(leaderboard(tmp_path), "md")
    assert "<img" not in markdown
    assert "[x](" not in markdown
    assert "\x1b" not in markdown
    assert len({line.replace(r"\|", "").count("|") for line in markdown.splitlines() if line.startswith("| ")}) == 1
    for row in csv.DictReader(io.StringIO(export(leaderboard(tmp_path), "csv"))):
        assert row["method"].startswith("'=cmd")
        assert "\x1b" not in row["method"]


def test_every_table_line_has_the_same_number_of_cells(tmp_path):
    write_run(tmp_path / "a", "one", datasets=("adt", "gimo"))
    write_run(tmp_path / "b", "two", datasets=("adt",))
    text = export(leaderboard(tmp_path), "md")
    for heading in ("adt title", "gimo title", "Mean over"):
        assert len({len(row) for row in cells(text, heading)}) == 1
    for before, line in itertools.pairwise(text.splitlines()):
        if line.startswith("|") and not before.startswith("|"):
            assert before == ""  # a table needs an empty line before it


def test_the_order_of_the_paths_and_naming_a_run_twice_change_nothing(tmp_path):
    a, b = write_run(tmp_path / "a", "one"), write_run(tmp_path / "b", "two")
    assert export(leaderboard(b, a, a, tmp_path), "json") == export(leaderboard(a, b), "json")


def test_a_run_that_is_not_finished_is_named_and_left_out(tmp_path):
    write_run(tmp_path / "a", "one")
    (write_run(tmp_path / "b", "two") / "synthetic-adt/summary.json").unlink()
    board = leaderboard(tmp_path)
    assert [row.entry.method for row in only(board.tables).rows] == ["one"]
    assert board.notes == ("Left out: b: not finished on synthetic-adt; run it again, it resumes.",)
    assert "not finished" in export(board, "md")


def test_a_folder_without_runs_and_an_unknown_format_are_errors(tmp_path):
    with pytest.raises(RunError, match=r"expected a run folder .* found none"):
        collect_runs([tmp_path])
    with pytest.raises(RunError, match=r"gone"):
        collect_runs([tmp_path / "gone"])
    write_run(tmp_path / "a")
    with pytest.raises(UsageError, match=r"unknown format 'html'; known ones are: md, csv, json"):
        export(leaderboard(tmp_path), "html")


def with_copies(copies: int) -> tuple[MetricSummary, ...]:
    return tuple(
        msgspec.structs.replace(one, flags={"recorded_motion": copies} if one.metric == "mpjpe" else {})
        for one in metrics(prime_success=0.9)
    )


def test_recorded_motion_that_was_handed_in_is_marked_and_never_ranked(tmp_path):
    write_run(tmp_path / "a", "one", prime_success=0.4)
    write_run(tmp_path / "b", "two", prime_success=0.3)
    write_run(tmp_path / "c", "copy", summary={"metrics": with_copies(80)})
    board = leaderboard(tmp_path)
    rows = {row.entry.method: row for row in only(board.tables).rows}
    assert rows["copy"].ranks == {}
    assert rows["one"].ranks["prime_success"] == 1
    text = export(board, "md")
    assert "| copy †† |" in text
    assert "- copy †† equals the recorded motion in 80 of 80 motions; never ranked." in text
    assert "**90.00**" not in text
    notes = {row["method"]: row["note"] for row in csv.DictReader(io.StringIO(export(board, "csv")))}
    assert "†† equals the recorded motion in 80 of 80 motions" in notes["copy"]
    assert "††" not in notes["one"]
    rows = only(json.loads(export(board, "json"))["tables"])["rows"]
    marks = {row["record"]["method"]["name"]: row["mark"] for row in rows}
    assert marks["copy"].startswith("††")
    assert marks["one"] == ""


def test_a_single_motion_that_equals_the_recorded_one_is_shown_and_may_be_an_accident(tmp_path):
    write_run(tmp_path / "a", "one", sequences=200)
    write_run(tmp_path / "b", "two", sequences=200, summary={"metrics": with_copies(1)})
    rows = {row.entry.method: row for row in only(leaderboard(tmp_path).tables).rows}
    assert rows["two"].entry.mark == "†† equals the recorded motion in 1 of 200 motions"
    assert rows["two"].ranks["prime_success"] == 1


def test_every_export_says_whose_a_method_is(tmp_path):
    write_run(tmp_path / "a", "pr")
    foreign = msgspec.structs.replace(METHOD, name="glide", kind="package", package="glider", isolation="bubblewrap")
    write_run(tmp_path / "b", record={"method": foreign})
    write_run(tmp_path / "c", "forged", kind="built-in")
    write_run(tmp_path / "d", "ground-truth", kind="control")
    board = leaderboard(tmp_path)
    kinds = {row[1]: row[-1] for row in cells(export(board, "md"), "synthetic-adt title")[2:]}
    assert kinds == {
        "pr": "built in",
        "glide": "package glider 1, isolated: bubblewrap",
        "forged": "unknown kind",
        "ground-truth": "control",
    }
    assert {row["method"]: row["kind"] for row in csv.DictReader(io.StringIO(export(board, "csv")))} == kinds
    rows = only(json.loads(export(board, "json"))["tables"])["rows"]
    methods = {row["record"]["method"]["name"]: row["record"]["method"] for row in rows}
    assert (methods["glide"]["kind"], methods["glide"]["isolation"]) == ("package", "bubblewrap")
    assert {row["record"]["method"]["name"]: row["origin"] for row in rows} == kinds


@pytest.mark.parametrize("kind", ["package", "program", "file"])
def test_a_foreign_method_under_a_name_of_prbenchs_is_left_out_with_the_reason(tmp_path, kind):
    write_run(tmp_path / "a", "static")
    write_run(tmp_path / "b", "ground-truth", kind=kind)
    board = leaderboard(tmp_path)
    assert [row.entry.method for row in only(board.tables).rows] == ["static"]
    assert only(board.notes).startswith("Left out: b: 'ground-truth' is a control of prbench")


def test_methods_of_one_name_and_two_kinds_are_two_rows_of_the_mean(tmp_path):
    for folder, kind in (("a", "package"), ("b", "program")):
        method = msgspec.structs.replace(METHOD, name="glide", kind=kind, package="x")
        write_run(tmp_path / folder, datasets=("adt", "gimo"), record={"method": method})
    rows = only(leaderboard(tmp_path).macro).rows
    assert sorted(row.origin for row in rows) == ["package x 1", "program x"]
    assert all(row.missing == () for row in rows)


def test_a_method_that_is_better_on_every_dataset_is_better_in_the_mean(tmp_path):
    write_run(tmp_path / "a", "one", datasets=("adt", "gimo"), prime_success=0.2)
    write_run(tmp_path / "b", "two", datasets=("adt", "gimo"), prime_success=0.3)
    rows = {row.method: row for row in only(leaderboard(tmp_path).macro).rows}
    assert (rows["one"].ranks["prime_success"], rows["two"].ranks["prime_success"]) == (2, 1)


def test_methods_that_the_data_do_not_separate_share_a_rank_and_no_winner_is_bold(tmp_path):
    for name, mean in (("one", 0.29), ("two", 0.19), ("three", 0.1)):
        write_run(tmp_path / name, name, prime_success=mean)

    def separate(rows, metrics):
        place = {row.method: i for i, row in enumerate(rows)}
        if not rows:
            return {}
        return {(place["three"], "prime_success"): frozenset({place["one"]})}

    board = make_leaderboard(collect_runs([tmp_path], check=as_stored), separate=separate)
    rows = {row.entry.method: row for row in only(board.tables).rows}
    assert [rows[name].ranks["prime_success"] for name in ("one", "two", "three")] == [1, 1, 2]
    assert not any(row.leads for row in rows.values())
    text = export(board, "md")
    assert "**" not in text
    assert "Prime Success: 1. one, two; 2. three (methods of one group are not separated)" in text
    assert re.search(r"the data separate no two methods in .*Reach Success", text)


@pytest.mark.parametrize(("recordings", "sequences", "reason"), [(3, 300, "3 recordings"), (11, 22, "22 sequences")])
def test_a_dataset_that_cannot_be_decided_says_so(tmp_path, recordings, sequences, reason):
    write_run(tmp_path / "a", "one", sequences=sequences, summary={"recordings": recordings})
    write_run(tmp_path / "b", "two", sequences=sequences, summary={"recordings": recordings})
    board = leaderboard(tmp_path)
    assert f"synthetic-adt cannot be decided: {reason}" in export(board, "md")
    assert any(reason in line for line in json.loads(export(board, "json"))["tables"][0]["undecided"])


def test_arrivals_from_the_edge_are_counted_on_every_board(tmp_path):
    arrival = next(entry for entry in metrics() if entry.metric == "prime_success")
    arrival = msgspec.structs.replace(
        arrival, metric="prime_success_arrival", title="Prime Success (arrival)", mean=0.5,
        flags={"arrived_from_the_edge": 7},
    )  # fmt: skip
    write_run(tmp_path / "a", "one", summary={"metrics": (*metrics(), arrival)})
    board = leaderboard(tmp_path)
    said = "7 of 40 arrivals of Prime Success (arrival) come from just outside the target"
    assert f"one: {said}" in export(board, "md").replace("\\", "")
    rows = list(csv.DictReader(io.StringIO(export(board, "csv"))))
    assert {row["metric"] for row in rows if said in row["note"]} == {"prime_success_arrival"}
    (row,) = json.loads(export(board, "json"))["tables"][0]["rows"]
    assert row["summary"]["metrics"][-1]["flags"] == {"arrived_from_the_edge": 7}
    (table,) = methods_table(board, "2", with_published=False)
    assert any(said in note for note in table.notes)


def test_the_smallest_detectable_difference_stands_below_the_table(tmp_path):
    known = {"prime_success": 0.27, "mpjpe": 0.034, "reach_success": 1.3}
    entries = tuple(msgspec.structs.replace(entry, detectable=known.get(entry.metric)) for entry in metrics())
    write_run(tmp_path / "a", "one", summary={"metrics": entries})
    text = export(leaderboard(tmp_path), "md")
    assert "Prime Success 27 points" in text
    assert "Reach Success none (not even 100 points)" in text
    assert "MPJPE 0.034 m" in text
    rows = list(csv.DictReader(io.StringIO(export(leaderboard(tmp_path), "csv"))))
    assert {row["metric"]: row["detectable"] for row in rows if row["detectable"]} == {
        "prime_success": "27",
        "reach_success": "130",
        "mpjpe": "0.034",
    }
