"""A table works through its rows unattended, resumes, and shows dashes where it has nothing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError, RunError, StorageError, UsageError
from prbench.leaderboard.tables import FEWEST_RANKED
from prbench.storage import text_digest
from prbench.workflows.table_two import TableRequest, plan, run, run_table, subset
from prbench.workflows.table_two.budget import RowCost
from prbench.workflows.table_two.request import CONTROLS
from prbench.workflows.table_two.run import Say
from prbench.workflows.table_two.state import TablePlan


def request(*tables, out: Path, **changes) -> TableRequest:
    return TableRequest(**{"data": tuple(table.folder for table in tables), "out": out, "limit": 3, **changes})


def lines(report, dataset: int = 0) -> dict:
    return {line.name: line for block in report.layout.datasets[dataset].blocks for line in block.lines}


def results(folder: Path) -> dict[str, bytes]:
    """All that must not depend on interruptions."""
    found = (path for path in sorted((folder / "rows").rglob("*")) if path.is_file() and path.name != "cost.json")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_rows_end_well_break_or_are_skipped_and_the_table_goes_on(small_tables, made_up, tmp_path, monkeypatch):
    monkeypatch.setattr(plan, "CONTROLS", CONTROLS)
    said = []
    report = run_table(
        request(small_tables[0], out=tmp_path / "t", weights=made_up.weights), say=Say(notice=said.append)
    )
    states = {name: line.state for name, line in lines(report).items()}
    assert states == {
        "none-static-mean-training-pose": "run",
        "text-breaker-finetuned": "failed",
        "text-stranger-finetuned": "skipped",
        "goal-loc-absent-finetuned": "skipped",
        "goal-loc-reacher-pretrained": "skipped",
        "goal-loc-reacher-finetuned": "run",
        "ground-truth": "run",
        "ground-truth-resampled": "run",
        "scripted": "run",
    }
    text = "\n".join(said)
    assert "Breaker (text): failed, " in text
    assert "no such luck" in text
    assert "Stranger (text): skipped, no method 'stranger' is installed" in text
    assert "absent: found no weights absent-small. Train some." in text
    assert "Reacher † (goal-loc): skipped, no weights (zero-shot) come with prbench; --weights FOLDER" in text
    assert "synthetic-adt n = 3 of 5" in text
    assert [outcome.planned.name for outcome in report.failed] == ["text-breaker-finetuned"]
    assert all(cell is None for cell in lines(report)["text-breaker-finetuned"].cells.values())


def test_a_defect_costs_one_row_and_a_full_disk_all(small_tables, tmp_path, monkeypatch):
    def run_method(asked, **settings):
        if asked.method == "reacher":
            raise error
        return real(asked, **settings)

    real = run.run_method
    monkeypatch.setattr(run, "run_method", run_method)
    error: Exception = RecursionError("round and round")
    report = run_table(request(small_tables[0], out=tmp_path / "t", method="reacher"))
    assert lines(report)["goal-loc-reacher-finetuned"].reason == "RecursionError: round and round"
    assert lines(report)["ground-truth"].state == "run"
    error = StorageError("no space left on the device")
    with pytest.raises(StorageError, match="no space left"):
        run_table(request(small_tables[0], out=tmp_path / "t", method="reacher"))


def test_cells_hold_what_the_runs_say(small_tables, tmp_path):
    report = run_table(request(small_tables[0], out=tmp_path / "t"))
    found = lines(report)
    summary = json.loads((tmp_path / "t/rows/goal-loc-reacher-finetuned/summary.json").read_text())
    means = {metric["metric"]: metric["mean"] for metric in summary["metrics"]}
    cells = found["goal-loc-reacher-finetuned"].cells
    assert list(cells) == [
        "prime_success",
        "reach_success",
        "goal_mpjpe",
        "location_error",
        "mpjpe",
        "foot_skating",
    ]  # the study's order
    assert cells["reach_success"].mean == 100.0
    assert cells["mpjpe"].mean == means["mpjpe"]
    assert found["none-static-mean-training-pose"].cells["foot_skating"] is None  # it stands still
    assert found["ground-truth"].cells["mpjpe"].mean == 0.0
    cost = found["goal-loc-reacher-finetuned"].cost
    assert cost.network_passes == 3
    assert cost.seconds > 0
    assert cost.memory_mebibytes > 1
    assert found["ground-truth"].cost.seconds is None


def test_several_tables_stand_in_the_studys_order_in_both_files(small_tables, tmp_path):
    report = run_table(request(*small_tables, out=tmp_path / "t", condition=Condition.GOAL_LOCATION))
    assert [part.dataset for part in report.layout.datasets] == ["synthetic-hd-epic", "synthetic-adt"]
    assert [block.title for block in report.layout.datasets[0].blocks] == ["+ Initial State & Object Loc.", "Controls"]
    page = (tmp_path / "t/table_2.md").read_text()
    assert page.count("| + Initial State & Object Loc. | Absent | – | – | – | – | – | – | – | – | – |") == 2
    assert "n = 3 sequences of" in page
    assert "Nothing is ranked on synthetic-hd-epic, synthetic-adt: fewer than 50 sequences." in page
    assert "never compare them with published ones" in page
    assert "Reacher (reacher-small)" in page  # what stands in is named
    saved = json.loads((tmp_path / "t/table_2.json").read_text())
    assert [part["dataset"] for part in saved["datasets"]] == ["synthetic-hd-epic", "synthetic-adt"]
    row = saved["datasets"][1]["blocks"][0]["lines"][2]
    assert (row["label"], row["method"], row["weights"], row["state"]) == (
        "Reacher",
        "reacher",
        "reacher-finetuned",
        "run",
    )
    assert row["cells"]["reach_success"]["mean"] == 100.0


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
    assert lines(run_table(asked))["goal-loc-reacher-pretrained"].state == "skipped"
    before = results(tmp_path / "t")
    (made_up.weights / "reacher-pretrained.safetensors").write_text("w")
    line = lines(run_table(asked))["goal-loc-reacher-pretrained"]
    assert line.state == "run"
    assert line.weights_used == "reacher-pretrained.safetensors"
    assert not line.stands_in
    after = results(tmp_path / "t")
    assert {name: after[name] for name in before} == before


def test_the_users_weights_come_before_the_bundled_ones(small_tables, made_up, tmp_path):
    (made_up.weights / "reacher-finetuned").write_text("w")
    report = run_table(request(small_tables[0], out=tmp_path / "t", weights=made_up.weights, method="reacher"))
    line = lines(report)["goal-loc-reacher-finetuned"]
    assert (line.weights_used, line.stands_in) == ("reacher-finetuned", False)


def test_nothing_is_ranked_below_fifty_sequences_and_controls_never(large_table, made_up, tmp_path):
    (made_up.weights / "reacher-pretrained.safetensors").write_text("w")
    asked = {
        "weights": made_up.weights,
        "condition": Condition.GOAL_LOCATION,
        "options": {"reacher.spread": "0.2"},
    }
    few = run_table(request(large_table, out=tmp_path / "few", limit=FEWEST_RANKED - 1, **asked))
    assert not [cell for line in lines(few).values() for cell in line.cells.values() if cell and cell.rank]
    assert not few.layout.datasets[0].blocks[0].order
    enough = run_table(request(large_table, out=tmp_path / "enough", limit=FEWEST_RANKED, **asked))
    ranked = {name for name, line in lines(enough).items() if any(c and c.rank for c in line.cells.values())}
    assert ranked == {"goal-loc-reacher-pretrained", "goal-loc-reacher-finetuned"}
    (step,) = enough.layout.datasets[0].blocks[0].order
    assert {step.better, step.worse} == ranked
    assert not step.supported  # the same method twice
    page = (tmp_path / "enough/table_2.md").read_text()
    assert "by Prime Success: Reacher" in page
    assert "not supported by the data" in page
    assert "**" in page


def test_shuffled_goals_stand_among_the_controls(small_tables, tmp_path):
    report = run_table(request(small_tables[0], out=tmp_path / "t", method="reacher", shuffled_goal=True))
    controls = report.layout.datasets[0].blocks[-1]
    assert controls.title == "Controls"
    assert [line.label for line in controls.lines] == [
        "ground-truth",
        "Reacher †, goal-loc, shuffled-goal",
        "Reacher, goal-loc, shuffled-goal",
    ]
    shuffled, own = (lines(report)[f"goal-loc-reacher-finetuned{end}"] for end in ("-shuffled-goal", ""))
    assert own.cells["reach_success"].mean == 100.0
    assert shuffled.cells["reach_success"].mean < 50.0


def test_the_subset_follows_from_a_measured_batch_and_is_kept(small_tables, made_up, tmp_path):
    said = []
    asked = request(small_tables[0], out=tmp_path / "t", limit=None, minutes=10, method="reacher", batch_size=2)
    report = run_table(asked, say=Say(notice=said.append))
    assert report.layout.limit == 5  # all: made-up motions cost nothing
    assert "synthetic-adt n = 5 of 5: what fits into 10 minutes here" in said[-1]
    assert "n is what fitted into 10 minutes" in (tmp_path / "t/table_2.md").read_text()
    batches = [f"reacher goal-loc {size}" for size in (5, 2, 2, 1)]
    assert made_up.calls() == batches  # the one that is timed, in one piece, and those that count
    written = json.loads((tmp_path / "t/plan.json").read_text())
    assert written["limit"] == 5
    assert set(written["costs"]) == {"goal-loc-reacher-finetuned", "ground-truth"}
    run_table(asked)
    assert made_up.calls() == []


def test_a_slow_row_makes_the_subset_smaller(small_tables, made_up, tmp_path):
    asked = request(small_tables[0], out=tmp_path / "t", limit=None, minutes=10, method="reacher")
    slow = RowCost(seconds_per_frame=2.0, overhead=1.0)  # about 170 s a sequence
    costs = {"goal-loc-reacher-finetuned": slow, "ground-truth": RowCost(seconds_per_frame=0.0, overhead=0.0)}
    digest = text_digest(*asked.deciding(asked.tables()))
    TablePlan(asked=digest, limit=None, minutes=10, costs=costs).write(tmp_path / "t")
    report = run_table(asked)
    assert report.layout.limit == 3
    assert made_up.calls() == ["reacher goal-loc 3"]  # nothing was timed again


def test_rows_that_there_was_no_time_to_time_count_as_the_slowest(small_tables, made_up, tmp_path, monkeypatch):
    monkeypatch.setattr(subset, "TIMING_SHARE", -1.0)
    asked = request(small_tables[0], out=tmp_path / "t", limit=None, minutes=10, method="reacher")
    slow = RowCost(seconds_per_frame=2.0, overhead=1.0)  # two rows of about 170 s a sequence in nine minutes
    digest = text_digest(*asked.deciding(asked.tables()))
    TablePlan(asked=digest, limit=None, minutes=10, costs={"ground-truth": slow}).write(tmp_path / "t")
    assert run_table(asked).layout.limit == 1
    assert made_up.calls() == ["reacher goal-loc 1"]


def test_another_request_is_refused_in_the_same_folder(small_tables, tmp_path):
    run_table(request(small_tables[0], out=tmp_path / "t", method="reacher"))
    with pytest.raises(RunError, match="--limit, --seed"):
        run_table(request(small_tables[0], out=tmp_path / "t", method="reacher", seed=1))
    (tmp_path / "full").mkdir()
    (tmp_path / "full/precious.txt").touch()
    with pytest.raises(StorageError, match=r"holds no plan\.json"):
        run_table(request(small_tables[0], out=tmp_path / "full"))


def test_requests_that_do_not_fit_together_are_refused(small_tables, tmp_path):
    table = small_tables[0]
    with pytest.raises(UsageError, match=r"expected METHOD\.spread="):
        request(table, out=tmp_path / "t", options={"spread": "1"})
    with pytest.raises(UsageError, match=r"expected METHOD\.spread="):
        request(table, out=tmp_path / "t", options={"reachr.spread": "1"})
    with pytest.raises(UsageError, match="expected a folder of weights for a table, found no folder"):
        request(table, out=tmp_path / "t", weights=tmp_path / "nowhere")
    (tmp_path / "misnamed").mkdir()
    (tmp_path / "misnamed/reacher.safetensors").touch()
    with pytest.raises(UsageError, match=r"found a folder without any.*reacher-finetuned"):
        request(table, out=tmp_path / "t", weights=tmp_path / "misnamed")
    with pytest.raises(UsageError, match="synthetic-adt more than once"):
        run_table(request(table, table, out=tmp_path / "t"))
    with pytest.raises(AdapterError, match="unknown option 'spraed'"):
        run_table(request(table, out=tmp_path / "t", options={"reacher.spraed": "1"}))


def test_options_reach_their_method_only(small_tables, tmp_path):
    run_table(request(small_tables[0], out=tmp_path / "t", options={"reacher.spread": "0.5"}))
    recorded = {
        name: json.loads((tmp_path / f"t/rows/{name}/run.json").read_text())["method"]["options"]
        for name in ("goal-loc-reacher-finetuned", "none-static-mean-training-pose")
    }
    assert recorded == {"goal-loc-reacher-finetuned": {"spread": "0.5"}, "none-static-mean-training-pose": {}}
