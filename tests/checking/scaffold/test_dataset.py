"""A new dataset's folder: clean, installable, passing the tests that it comes with; names that cannot be used."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from prbench.cli import main
from tests.cli.reports import refused


def run(*command: str, cwd: Path, path: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(path), "PRBENCH_CACHE": str(cwd / "cache")}
    done = subprocess.run([sys.executable, *command], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_new_dataset_is_installed_passes_its_tests_and_is_built(tmp_path, capsys):
    folder = tmp_path / "prbench-night-desk"
    site = tmp_path / "site"
    assert main(["datasets", "new", "night-desk", "--out", str(folder)]) == 0
    steps = [line.strip() for line in capsys.readouterr().out.splitlines()[1:]]
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    run("-m", "pip", "install", *options, "--target", str(site), str(folder), cwd=tmp_path, path=site)
    run("-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder / "tests"), cwd=tmp_path, path=site)
    for step in steps[3:]:
        program, *words = step.split()
        run(*(words if program == "python" else ["-m", "prbench", *words]), cwd=folder, path=site)
    assert "night-desk" in run("-m", "prbench", "inspect", "tables/night-desk", cwd=folder, path=site)


@pytest.mark.parametrize("name", ["tabletop", "night-desk-2"])
def test_everything_is_clean_under_ruff_and_no_mark_is_left(name, tmp_path):
    assert main(["datasets", "new", name, "--out", str(tmp_path / "new")]) == 0
    assert not any("<<" in path.read_text("utf-8") for path in (tmp_path / "new").rglob("*") if path.is_file())
    ruff = shutil.which("ruff")
    if ruff is None:
        pytest.skip("ruff is not installed")
    for command in (["check", "--select", "E,F,I"], ["format", "--check"]):
        done = subprocess.run([ruff, *command, "--no-cache", "."], cwd=tmp_path / "new", capture_output=True, text=True)
        assert done.returncode == 0, done.stdout[-2000:]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("My_Desk", "Would 'my-desk' do?"),
        ("3d", "expected the name of a dataset in small letters and digits"),
        ("prbench-desk", "Give 'desk'"),
        ("hdepic", "'hd-epic' is a dataset of prbench already"),
        ("nymeria", "'nymeria' is a dataset of prbench already"),
        ("list", "'list' is a reserved word"),
        ("synthetic-desk", "reserved word"),
        ("adapters", "is a reserved name"),
        ("x" * 41, "at most 40 characters"),
    ],
)
def test_a_name_that_cannot_be_used_is_refused_with_the_reason(name, message, tmp_path, capsys):
    refused(["datasets", "new", name, "--out", str(tmp_path / "new")], capsys, code=2, message=message)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_is_left_as_it_is(tmp_path, capsys):
    (tmp_path / "mine.txt").write_text("mine")
    refused(["datasets", "new", "desk", "--out", str(tmp_path)], capsys, code=8, message="nothing was written")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
