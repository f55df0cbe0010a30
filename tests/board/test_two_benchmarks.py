"""Boards and comparisons of runs of motion prediction, and of both benchmarks side by side."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from prbench.board import collect_runs, compare_runs, export, make_leaderboard
from prbench.errors import RunError
from prbench.harness.first_run import table_finder
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker
from prbench.harness.run import run_method
from prbench.harness.run_folder.summary import share_a_mean
from prbench_benchmarks.motion_prediction.table import write_windows
from tests.benchmarks.motion_prediction.windows import cut, info, walking


def windows(folder: Path, dataset: str, *, estimated: bool = False) -> Path:
    """Windows of two recordings."""
    described = msgspec.structs.replace(info(), dataset=dataset, estimated_bodies=estimated)
    write_windows(folder, described, map(cut, (walking("a", 150), walking("b", 135, number=2))))
    return folder


def run(out: Path, method: str, *data: Path):
    """A small run of motion prediction."""
    request = RunRequest(
        benchmark="motion-prediction", method=method, condition="pose", data=data, samples=1, batch_size=8, out=out
    )
    return run_method(request)


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """``stay`` and ``go`` on one table; ``both`` on a captured and an estimated one."""
    folder = tmp_path_factory.mktemp("runs")
    captured = windows(folder / "tables" / "captured", "captured")
    estimated = windows(folder / "tables" / "estimated", "estimated", estimated=True)
    run(folder / "stay", "zero-velocity", captured)
    run(folder / "go", "constant-velocity", captured)
    run(folder / "both", "zero-velocity", captured, estimated)
    return folder


def board(*folders: Path, data: tuple[Path, ...] = ()):
    """A board of some runs."""
    check = RunChecker(table_finder(data)).check
    return make_leaderboard(collect_runs(folders, check=check, any_benchmark=True))


def test_a_board_of_motion_prediction_has_its_columns_and_title(runs):
    text = export(board(runs / "stay", runs / "go"), "md")
    assert text.startswith("# Motion prediction leaderboard\n")
    assert "| ADE ↓ (m) | FDE ↓ (m) | MMADE ↓ (m) | MMFDE ↓ (m) | APD ↑ (m) |" in text
    assert "Prime Success" not in text


def test_exports_name_the_benchmark(runs):
    made = board(runs / "stay")
    assert "benchmark motion-prediction" in export(made, "csv")
    assert msgspec.json.decode(export(made, "json"))["tables"][0]["benchmark"] == "motion-prediction"


def test_scores_are_verified_on_the_windows(runs):
    made = board(runs / "stay", data=(runs / "tables" / "captured",))
    assert made.tables[0].rows[0].entry.unverified == ""
    unnamed = board(runs / "stay")
    assert "not at hand" in unnamed.tables[0].rows[0].entry.unverified


def test_estimated_and_captured_bodies_never_enter_one_mean(runs):
    made = board(runs / "both")
    assert len(made.tables) == 2
    assert made.macro == ()
    assert not share_a_mean([table.rows[0].entry.table for table in made.tables])


def test_predictors_are_compared_window_by_window(runs):
    compared = compare_runs(runs / "stay", runs / "go")
    assert [row.info.id for row in compared.metrics] == ["ade", "fde", "mmade", "mmfde"]
    assert compared.metrics[0].comparison.difference.n_recordings == 2
    assert compared.metrics[0].comparison.conclusion == "cannot be tested"


def test_other_callers_are_told_the_benchmark(runs):
    with pytest.raises(RunError, match="a run of the benchmark motion-prediction"):
        collect_runs([runs / "stay"])
