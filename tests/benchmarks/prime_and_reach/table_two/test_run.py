"""A table works through its rows unattended, resumes, and shows dashes where it has nothing."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pyarrow.compute as pc
import pytest

from prbench.board.tables import FEWEST_RANKED
from prbench.contract import Condition
from prbench.errors import AdapterError, RunError, StorageError, UsageError
from prbench.files.storage import sole_writer
from prbench.harness.run_folder import read_scores
from prbench.tables import Cell, Row
from prbench_benchmarks.prime_and_reach.table_two import request as requests
from prbench_benchmarks.prime_and_reach.table_two import run
from prbench_benchmarks.prime_and_reach.table_two.request import CONTROLS, MORE_CONTROLS, TableRequest
from prbench_benchmarks.prime_and_reach.table_two.run import run_table
from tests.fakes import fake_dataset


def request(*tables, out: Path, **changes) -> TableRequest:
    return TableRequest(**{"data": tuple(table.folder for table in tables), "out": out, "limit": 3, **changes})


def rows(report, dataset: int = 0) -> dict[str, Row]:
    """The rows of a part that have numbers, by their label."""
    return {row.text["method"]: row for block in report.tables[dataset].blocks for row in block.rows}


def cell(row: Row, metric: str) -> Cell:
    return next(each for each in row.cells if each.metric == metric)


def results(folder: Path) -> dict[str, bytes]:
    """All that must not depend on interruptions."""
    found = (path for path in sorted((folder / "rows").rglob("*")) if path.is_file() and path.name != "cost.json")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_rows_end_well_break_or_are_skipped_and_the_table_goes_on(small_tables, made_up, tmp_path, monkeypatch):
    monkeypatch.setattr(requests, "CONTROLS", CONTROLS)
    said = []
    report = run_table(request(small_tables[0], out=tmp_path / "t", weights=made_up.weights), notice=said.append)
    assert list(rows(report)) == ["Static", "Reacher", "ground-truth", "ground-truth-resampled", "scripted"]
    text = "\n".join(said)
    assert "Breaker (text): failed, " in text
    assert "no such luck" in text
    assert "Stranger (text): skipped, no method 'stranger' is installed" in text
    assert "absent: found no weights absent-small. Train some." in text
    assert "Reacher † (goal-loc): skipped, no weights (zero-shot) come with prbench; --weights FOLDER" in text
    assert "synthetic-adt n = 3 of 5" in text
    assert list(report.failed) == ["text-breaker-finetuned"]
    # What has no numbers stands in the notes, with the reason.
    notes = "\n".join(report.tables[0].notes)
    assert "Breaker (text): failed, " in notes
    assert "Reacher † (goal-loc): skipped, " in notes


def test_cheats_stand_among_the_controls_if_asked_for_and_arrival_tells_them_apart(small_tables, tmp_path):
    asked = request(small_tables[0], out=tmp_path / "t", condition=Condition.NONE, more_controls=True)
    report = run_table(asked)
    found = rows(report)
    assert {name.removesuffix(" (††)") for name in found} == {"Static", "ground-truth", *MORE_CONTROLS}
    assert cell(found["stare"], "prime_success_arrival").value == 0.0
    page = (tmp_path / "t/table_2.md").read_text()
    assert re.search(r"\| control \| stare \| [^|]+ \| 0\.00 ", page)
    with pytest.raises(RunError, match="--with-controls"):
        run_table(replace(asked, more_controls=False))


def test_a_table_of_which_nothing_can_be_run_says_why(small_tables, tmp_path, monkeypatch):
    monkeypatch.setattr(requests, "CONTROLS", ())
    report = run_table(request(small_tables[0], out=tmp_path / "t", method="stranger"))
    (table,) = report.tables
    assert table.notes == ("Stranger (text): skipped, no method 'stranger' is installed",)


def test_a_defect_costs_one_row_and_a_full_disk_all(small_tables, tmp_path, monkeypatch):
    def run_method(asked, **settings):
        if asked.method == "reacher":
            raise error
        return real(asked, **settings)

    real = run.run_method
    monkeypatch.setattr(run, "run_method", run_method)
    error: Exception = RecursionError("round and round")
    report = run_table(request(small_tables[0], out=tmp_path / "t", method="reacher"))
    assert report.failed == {"goal-loc-reacher-finetuned": "RecursionError: round and round"}
    assert list(rows(report)) == ["ground-truth"]
    error = StorageError("no space left on the device")
    with pytest.raises(StorageError, match="no space left"):
        run_table(request(small_tables[0], out=tmp_path / "t", method="reacher"))


def test_a_row_that_fails_leaves_nothing_behind_and_is_tried_again(small_tables, made_up, tmp_path):
    asked = request(small_tables[0], out=tmp_path / "t", weights=made_up.weights, batch_size=1)
    run_table(asked)
    assert made_up.calls().count("breaker text 1") == 1  # the other two batches would fail as well
    assert not (tmp_path / "t/rows/text-breaker-finetuned").exists()
    run_table(asked)
    assert made_up.calls() == ["breaker text 1"]


def test_cells_hold_what_the_runs_say(small_tables, tmp_path):
    found = rows(run_table(request(small_tables[0], out=tmp_path / "t")))
    summary = json.loads((tmp_path / "t/rows/goal-loc-reacher-finetuned/synthetic-adt/summary.json").read_text())
    means = {metric["metric"]: metric["mean"] for metric in summary["metrics"]}
    assert cell(found["Reacher"], "reach_success").value == 100.0
    assert cell(found["Reacher"], "mpjpe").value == means["mpjpe"]
    assert cell(found["Static"], "foot_skating").value is None  # it stands still
    assert cell(found["ground-truth"], "mpjpe").value == 0.0


def test_several_tables_stand_in_the_studys_order_in_both_files(small_tables, tmp_path):
    report = run_table(request(*small_tables, out=tmp_path / "t", condition=Condition.GOAL_LOCATION))
    assert [part.dataset for part in report.tables] == ["synthetic-hd-epic", "synthetic-adt"]
    page = (tmp_path / "t/table_2.md").read_text()
    assert page.count("| + Initial State & Object Loc. | Reacher |") == 2
    assert page.count(": test, 3 sequences, ") == 2
    assert "synthetic-adt cannot be decided: " in page
    assert page.count("Nothing is ranked: fewer than 50 sequences.") == 2
    assert "never compare them with published ones" in page
    assert "Absent (goal-loc): skipped, " in page
    saved = json.loads((tmp_path / "t/table_2.json").read_text())
    assert [part["dataset"] for part in saved] == ["synthetic-hd-epic", "synthetic-adt"]
    (row,) = saved[1]["blocks"][0]["rows"]
    assert row["text"]["method"] == "Reacher"
    assert {each["metric"]: each["value"] for each in row["cells"]}["reach_success"] == 100.0


def test_a_killed_table_goes_on_to_the_same_files(small_tables, made_up, tmp_path):
    whole, broken = (request(*small_tables, out=tmp_path / name, batch_size=2) for name in ("whole", "broken"))
    run_table(whole)
    assert len([call for call in made_up.calls() if call.startswith("reacher")]) == 4
    made_up.stop("reacher")
    with pytest.raises(KeyboardInterrupt):
        run_table(broken)
    assert not (tmp_path / "broken/table_2.md").exists()
    made_up.stop("reacher", now=False)
    run_table(broken)
    assert results(tmp_path / "broken") == results(tmp_path / "whole")
    made_up.calls()
    run_table(broken)
    assert made_up.calls() == []  # nothing is generated twice


def test_weights_that_arrive_later_fill_their_row(small_tables, made_up, tmp_path):
    asked = request(small_tables[0], out=tmp_path / "t", weights=made_up.weights, condition=Condition.GOAL_LOCATION)
    assert "Reacher †" not in rows(run_table(asked))
    before = results(tmp_path / "t")
    (made_up.weights / "reacher-pretrained.safetensors").write_text("w")
    found = rows(run_table(asked))
    assert found["Reacher †"].cells[0].variant == "weights reacher-pretrained.safetensors"
    after = results(tmp_path / "t")
    assert {name: after[name] for name in before} == before


def test_the_users_weights_come_before_the_bundled_ones(small_tables, made_up, tmp_path):
    (made_up.weights / "reacher-finetuned").write_text("w")
    report = run_table(request(small_tables[0], out=tmp_path / "t", weights=made_up.weights, method="reacher"))
    assert rows(report)["Reacher"].cells[0].variant == "weights reacher-finetuned"
    assert not any("stand in" in note for note in report.tables[0].notes)


def test_nothing_is_ranked_below_fifty_sequences_and_controls_never(large_table, made_up, tmp_path):
    (made_up.weights / "reacher-pretrained.safetensors").write_text("w")
    asked = {"weights": made_up.weights, "condition": Condition.GOAL_LOCATION}
    few = run_table(request(large_table, out=tmp_path / "few", limit=FEWEST_RANKED - 1, **asked))
    assert not [each for row in rows(few).values() for each in row.cells if each.rank]
    enough = run_table(request(large_table, out=tmp_path / "enough", limit=FEWEST_RANKED, **asked))
    ranked = {name for name, row in rows(enough).items() if any(each.rank for each in row.cells)}
    assert ranked == {"Reacher †", "Reacher"}
    page = (tmp_path / "enough/table_2.md").read_text()
    (header,) = {row for row in page.splitlines() if row.startswith("| Condition")}
    assert header.count("|") - 1 == 2 + 8
    # The best mean is not bold where the data support no difference.
    assert not re.search(r"\*\*\d", page)


def test_every_line_is_scored_on_the_sequences_that_all_can_generate(large_table, made_up, tmp_path):
    (made_up.weights / "reacher-pretrained.safetensors").write_text("w")
    scalars = large_table.scalars(split="test")
    lengths = sorted(scalars["n_frames"].to_pylist())
    made_up.limit("reacher-pretrained", lengths[-2])
    short = sum(length <= lengths[-2] for length in lengths)
    assert FEWEST_RANKED <= short < len(lengths)
    asked = {"weights": made_up.weights, "condition": Condition.GOAL_LOCATION, "limit": len(lengths)}
    report = run_table(request(large_table, out=tmp_path / "t", **asked))
    (part,) = report.tables
    assert f": test, {short} sequences, " in part.part
    assert f" of {len(lengths)} that every method here generated" in part.part
    assert f"left out for all: reacher ({len(lengths) - short})." in "\n".join(part.notes)
    found = rows(report)
    common = set(scalars.filter(pc.field("n_frames") <= lengths[-2])["sequence_id"].to_pylist())
    labels = {"goal-loc-reacher-pretrained": "Reacher †", "goal-loc-reacher-finetuned": "Reacher"}
    for name, label in {**labels, "ground-truth": "ground-truth"}.items():
        scores = read_scores(tmp_path / "t" / "rows" / name / "synthetic-adt/scores.parquet").to_pylist()
        values = [row["value"] for row in scores if row["metric"] == "mpjpe" and row["sequence_id"] in common]
        assert len(values) == short
        assert cell(found[label], "mpjpe").value == pytest.approx(sum(values) / short)
    # Both rows are one method with one seed: on the same sequences they are equal and share the first place.
    assert [cell(found[label], "mpjpe").rank for label in labels.values()] == [1, 1]


def test_shuffled_goals_stand_among_the_controls(small_tables, tmp_path):
    report = run_table(request(small_tables[0], out=tmp_path / "t", method="reacher", shuffled_goal=True))
    beside = report.tables[0].blocks[-1]
    assert beside.title.startswith("Beside the study's rows: controls")
    labels = [row.text["method"] for row in beside.rows]
    (shuffled,) = (label for label in labels if "shuffled-goal" in label)
    assert sorted(labels) == sorted(["ground-truth", shuffled])
    assert cell(rows(report)["Reacher"], "reach_success").value == 100.0
    assert cell(rows(report)[shuffled], "reach_success").value < 50.0


def test_another_request_is_refused_in_the_same_folder(small_tables, tmp_path):
    first = request(small_tables[0], out=tmp_path / "t", method="reacher")
    run_table(first)
    with pytest.raises(RunError, match=r"another table: --seed was 0, now is 1\. Choose"):
        run_table(replace(first, seed=1))
    with pytest.raises(RunError, match="--limit was 3, now is 2"):
        run_table(replace(first, limit=2))
    with pytest.raises(RunError, match="table synthetic-hd-epic is new"):
        run_table(replace(first, data=tuple(table.folder for table in small_tables)))
    (tmp_path / "full").mkdir()
    (tmp_path / "full/precious.txt").touch()
    with pytest.raises(StorageError, match=r"holds no plan\.json"):
        run_table(request(small_tables[0], out=tmp_path / "full"))
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"file: is a file"):
        run_table(request(small_tables[0], out=tmp_path / "file"))


def test_a_table_that_was_built_anew_is_refused(tmp_path):
    asked = request(fake_dataset(tmp_path / "adt", 20), out=tmp_path / "t", method="reacher")
    run_table(asked)
    shutil.rmtree(tmp_path / "adt")
    fake_dataset(tmp_path / "adt", 24)
    with pytest.raises(RunError, match="table synthetic-adt has other contents now"):
        run_table(asked)


def test_one_process_at_a_time_works_on_a_table(small_tables, tmp_path):
    asked = request(small_tables[0], out=tmp_path / "t", method="reacher")
    with sole_writer(tmp_path / "t"), pytest.raises(StorageError, match=r"process \d+ on \S+ is writing there"):
        run_table(asked)
    run_table(asked)


def test_what_a_killed_process_was_writing_is_cleared_away(small_tables, tmp_path):
    asked = request(small_tables[0], out=tmp_path / "t", method="reacher")
    (tmp_path / "t").mkdir()
    (tmp_path / "t/.plan-abcd1234.partial.json").write_text("{")
    run_table(asked)
    row = tmp_path / "t/rows/goal-loc-reacher-finetuned"
    shutil.rmtree(row)
    row.mkdir()
    (row / ".run-abcd1234.partial.json").write_text("{")
    (tmp_path / "t/.table_2-abcd1234.partial.md").write_text("|")
    (tmp_path / "t/.table_2-abcd1234.partial.json").write_text("{")
    assert "Reacher" in rows(run_table(asked))
    assert not list((tmp_path / "t").rglob(".*"))


def test_requests_that_do_not_fit_together_are_refused(small_tables, tmp_path):
    table = small_tables[0]
    (tmp_path / "misnamed").mkdir()
    (tmp_path / "misnamed/reacher.safetensors").touch()
    for wrong, message in (
        ({"options": {"spread": "1"}}, r"expected METHOD\.spread="),
        ({"options": {"reachr.spread": "1"}}, r"expected METHOD\.spread="),
        ({"weights": tmp_path / "nowhere"}, "expected a folder of weights for a table, found no folder"),
        ({"weights": tmp_path / "misnamed"}, r"found a folder without any.*reacher-finetuned"),
    ):
        with pytest.raises(UsageError, match=message):
            request(table, out=tmp_path / "t", **wrong)
    with pytest.raises(UsageError, match="synthetic-adt more than once"):
        run_table(request(table, table, out=tmp_path / "t"))
    with pytest.raises(AdapterError, match="unknown option 'spraed'"):
        run_table(request(table, out=tmp_path / "t", options={"reacher.spraed": "1"}))
    assert not (tmp_path / "t").exists()  # so that the corrected command finds no other one's folder


def test_options_reach_their_method_only(small_tables, tmp_path):
    run_table(request(small_tables[0], out=tmp_path / "t", options={"reacher.spread": "0.5"}))
    recorded = {
        name: json.loads((tmp_path / f"t/rows/{name}/run.json").read_text())["method"]["options"]
        for name in ("goal-loc-reacher-finetuned", "none-static-mean-training-pose")
    }
    assert recorded == {"goal-loc-reacher-finetuned": {"spread": "0.5"}, "none-static-mean-training-pose": {}}
