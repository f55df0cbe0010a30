"""Run folders are found and read; cost is measured, declared, counted, or a dash."""

from __future__ import annotations

import json
import os
from types import SimpleNamespace

import pytest
import torch

from prbench.board import collect_runs, export
from prbench.board.collect import cost_of
from prbench.errors import RunError
from prbench.harness.methods.loading import count_parameters
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import FILE, RunCost, total_cost
from tests.board.runs import by_method, cells, csv_rows, leaderboard, write_run


def test_a_run_that_is_not_finished_is_named_and_left_out(tmp_path):
    write_run(tmp_path / "a", "one")
    (write_run(tmp_path / "b", "two") / "synthetic-adt/summary.json").unlink()
    board = leaderboard(tmp_path)
    assert list(by_method(board)) == ["one"]
    assert board.notes == ("Left out: b: not finished on synthetic-adt; run it again, it resumes.",)
    assert "not finished" in export(board, "md")


def test_a_folder_without_runs_is_an_error(tmp_path):
    with pytest.raises(RunError, match=r"expected a run folder .* found none"):
        collect_runs([tmp_path])
    with pytest.raises(RunError, match=r"gone"):
        collect_runs([tmp_path / "gone"])


def batch(*, warm_up: bool = False, parameters: int | None = 1_250_000) -> RunCost:
    rest = {"peak_process_bytes": 512 * 2**20, "network_passes_declared": 800, "parameters": parameters}
    if warm_up:
        return RunCost(warm_up_motions=8, warm_up_frames=800, warm_up_seconds=8.0, **rest)
    return RunCost(motions=8, frames=800, seconds=2.0, processor_seconds=4.0, **rest)


def test_seconds_without_warm_up_passes_a_motion_memory_and_parameters(tmp_path):
    run = write_run(tmp_path / "a", sequences=24)
    total_cost([batch(warm_up=True), batch(), batch()]).write(run / "synthetic-adt/cost.json")
    board = leaderboard(tmp_path)
    header, _, row = cells(export(board, "md"))
    shown = dict(zip(header, row, strict=True))
    wanted = {"s/motion": "0.250", "CPU s/motion": "0.500", "Passes/motion": "100", "Memory (MiB)": "512"}
    wanted["Parameters"] = "1250000"
    wanted = {f"{name} (declared)": value for name, value in wanted.items()}
    assert {name: shown[name] for name in wanted} == wanted
    first = csv_rows(board)[0]
    assert (first["seconds_per_motion"], first["parameters"]) == ("0.25", "1250000")
    assert json.loads(export(board, "json"))["tables"][0]["rows"][0]["cost"] == {
        "seconds": 0.25, "processor_seconds": 0.5, "network_passes": 100.0, "memory_mebibytes": 512.0,
        "parameters": 1_250_000,
    }  # fmt: skip


def test_a_single_batch_is_better_than_nothing(tmp_path):
    run = write_run(tmp_path / "a", sequences=8)
    total_cost([batch(warm_up=True, parameters=None)]).write(run / "synthetic-adt/cost.json")
    entry = by_method(leaderboard(tmp_path))["pr"].entry
    assert [entry.cost[name] for name in ("seconds", "processor_seconds", "parameters")] == [1.0, None, None]


def test_files_and_controls_without_measurements_have_dashes(tmp_path):
    write_run(tmp_path / "unmeasured")
    run = write_run(tmp_path / "file", "mine", about={"kind": FILE})
    total_cost([]).write(run / "synthetic-adt/cost.json")
    _, _, *rows = cells(export(leaderboard(tmp_path), "md"))
    assert [row[11:16] for row in rows] == [["–"] * 5] * 2


def test_a_merged_cost_is_the_sum_of_its_folds(tmp_path):
    runs = [RunFolder.open(write_run(tmp_path / name, sequences=24)) for name in ("merged", "one", "two")]
    files = [run.dataset("synthetic-adt").cost for run in runs]
    parts = [total_cost([batch(warm_up=True), batch()]), batch()]
    for path, cost in zip(files, (total_cost(parts), *parts), strict=True):
        cost.write(path)
    table = runs[0].record.tables[0]
    assert cost_of(runs[0], table, runs[1:])[1] == ""
    batch(parameters=2_500_000).write(files[2])
    assert cost_of(runs[0], table, runs[1:])[1] == "it is not the sum of the costs of its folds"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_in_place_of_scores_is_not_waited_for(tmp_path):
    scores = write_run(tmp_path / "a") / "synthetic-adt/scores.parquet"
    scores.unlink()
    os.mkfifo(scores)
    assert "a: not finished on synthetic-adt" in collect_runs([tmp_path]).left_out[0]


def test_parameters_of_networks_are_counted_once_wherever_they_are_held():
    first = torch.nn.Linear(3, 4)  # 16 parameters
    second = torch.nn.Sequential(torch.nn.Linear(2, 2), first)  # 6 of its own
    method = SimpleNamespace(model=SimpleNamespace(network=first), others={"a": [second]}, again=first, name="made")
    method.itself = method
    assert count_parameters(method) == 22
    assert count_parameters(SimpleNamespace(name="without")) is None
