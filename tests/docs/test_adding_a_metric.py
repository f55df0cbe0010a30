"""docs/adding-a-metric.md: its two files are written as they stand there, and its commands run as they are."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from prbench.harness.run_folder import DatasetSummary, read_scores
from tests.docs.interpreters import ROOT
from tests.fakes import fake_dataset

PAGE = (ROOT / "docs" / "adding-a-metric.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def run(checkout: Path, *command: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(checkout), "PRBENCH_CACHE": str(checkout / "cache"), "COLUMNS": "160"}
    done = subprocess.run([sys.executable, *command], cwd=checkout, env=environment, text=True, capture_output=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def checkout(tmp_path_factory) -> Path:
    """A copy of the repository with the two files of the page and nothing else edited, and a small dataset."""
    folder = tmp_path_factory.mktemp("metric") / "checkout"
    for name in ("prbench", "tests/metrics"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "tests" / "__init__.py").touch()
    for block in blocks("python"):
        (folder / block.splitlines()[0].removeprefix("# ")).write_text(block, encoding="utf-8")
    fake_dataset(folder / "tables" / "adt", 40)
    return folder


@pytest.fixture(scope="module")
def printed(checkout) -> list[str]:
    """What the commands of the page's last part print, one text a command."""
    return [run(checkout, "-m", *shlex.split(line)) for line in blocks("bash")[-1].splitlines()]


def test_the_hand_checked_cases_of_the_page_hold(checkout):
    case = "tests/metrics/test_wrist_error.py"
    assert "2 passed" in run(checkout, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=importlib", case)


@pytest.mark.slow
def test_the_metric_obeys_the_laws_that_hold_for_all(checkout):
    laws = "tests/metrics/test_score.py"
    by_name = "test_the_metrics_stand_in_printed_order"  # the page says that its list is to be extended
    options = ("-q", "-p", "no:cacheprovider", "--import-mode=importlib", f"--deselect={laws}::{by_name}")
    assert " passed" in run(checkout, "-m", "pytest", *options, laws)


def test_a_run_prints_and_keeps_the_metric_with_its_interval(checkout, printed):
    (line,) = (line for line in printed[0].splitlines() if "Final wrist error" in line)
    assert re.search(r"\d\.\d\d m .*\[\d\.\d\d, \d\.\d\d\]", line), line
    scores = read_scores(checkout / "runs/static/synthetic-adt/scores.parquet")
    assert "wrist_error" in scores["metric"].to_pylist()


def test_recorded_motion_against_other_goals_is_not_compared_with_itself(checkout, printed):
    assert "Reach Success" in printed[1]
    assert "Final wrist error" not in printed[1]
    summary = DatasetSummary.read(checkout / "runs/control/synthetic-adt")
    assert "wrist_error" not in [metric.metric for metric in summary.metrics]


def test_a_leaderboard_exports_the_metric_with_unit_and_direction(printed):
    (row,) = (line.split(",") for line in printed[2].splitlines() if ",wrist_error," in line)
    assert row[7:9] == ["m", "false"]


def test_scores_from_before_the_metric_are_made_anew_from_the_kept_motions(checkout, printed):
    before = (checkout / "runs/static/synthetic-adt/scores.parquet").read_bytes()
    parts = sorted((checkout / "runs/static/synthetic-adt/predictions").iterdir())
    written = [part.stat().st_mtime_ns for part in parts]
    for name in ("scores.parquet", "summary.json"):
        (checkout / "runs/static/synthetic-adt" / name).unlink()
    run(checkout, "-m", *shlex.split(blocks("bash")[-1].splitlines()[0]))
    assert (checkout / "runs/static/synthetic-adt/scores.parquet").read_bytes() == before
    assert [part.stat().st_mtime_ns for part in parts] == written
