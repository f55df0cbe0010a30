"""What needs no neural network needs no torch: the commands of a method's author on a machine that lacks it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"

BLOCKER = '''
"""Found by every Python of this test before anything else: as if torch were not installed."""
import sys

class NoTorch:
    asked = []

    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.split(".")[0] == "torch":
            cls.asked.append(name)
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None

sys.meta_path.insert(0, NoTorch)
'''

SCRIPT = """
import contextlib, io, json, sys
from sitecustomize import NoTorch
from prbench.cli import main

answers = {}
for name, words in json.load(sys.stdin).items():
    NoTorch.asked.clear()
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        try:
            status = main(words)
        except SystemExit as stopped:
            status = stopped.code
    answers[name] = [status, out.getvalue(), error.getvalue(), list(NoTorch.asked)]
sys.__stdout__.write(json.dumps(answers))
"""


@dataclass(frozen=True)
class Answer:
    """Of one command."""

    status: int
    out: str
    error: str
    asked: list[str]
    """Modules of torch that somebody tried to import."""


def commands(folder: Path) -> dict[str, list[str]]:
    """One after another; later ones use what earlier ones wrote."""
    data = ["--data", str(folder / "table")]
    program = f'cmd:"{sys.executable}" "{EXAMPLES / "glide.py"}"'

    def run(name: str, method: str, condition: str, *more: str) -> list[str]:
        out = ["--out", str(folder / "runs" / name)]
        return ["run", "--method", method, "--condition", condition, *data, *out, "--limit", "4", *more]

    return {
        "help": ["--help"],
        "list": ["adapters", "list"],
        "static": run("static", "static", "none"),
        "static isolated": run("isolated", "static", "none", "--isolate"),
        "program": run("program", program, "goal-loc"),
        "ground truth": run("ground-truth", "ground-truth", "goal-loc"),
        "through features": run("features", "ground-truth-resampled", "goal-loc"),
        "scripted": run("scripted", "scripted", "goal-loc"),
        "export": ["export-conditions", *data, "--condition", "goal-loc", "--out", str(folder / "asked.npz")],
        "score a run": ["score", str(folder / "runs" / "program"), *data],
        "score a file": ["score", str(folder / "recorded.parquet"), *data],
        "check": ["adapters", "check", "static", *data],
        "doctor": ["doctor", str(folder / "recorded.parquet")],
        "leaderboard": ["leaderboard", "export", str(folder / "runs" / "program"), "--format", "md"],
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A table, and its recorded motions as somebody would hand them in."""
    folder = tmp_path_factory.mktemp("without-torch")
    _hand_in(fake_dataset(folder / "table", 24), folder / "recorded.parquet")
    (folder / "site").mkdir()
    (folder / "site" / "sitecustomize.py").write_text(BLOCKER)
    return folder


def _hand_in(table: SequenceTable, path: Path) -> None:
    rows = [
        (name, chunk.joints[chunk.offsets[i] : chunk.offsets[i + 1]].reshape(-1, 66).tolist())
        for chunk in table.chunks(split="test")
        for i, name in enumerate(chunk.sequence_ids)
    ]
    names, joints = zip(*rows)
    pq.write_table(pa.table({"sequence_id": names, "joints": pa.array(joints, pa.list_(pa.list_(pa.float32())))}), path)


@pytest.fixture(scope="module")
def answers(folder) -> dict[str, Answer]:
    """What the commands printed, all of them in one process that has no torch."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "PRBENCH_CACHE": str(folder / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        input=json.dumps(commands(folder)),
        capture_output=True,
        text=True,
        env=environment,
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr
    return {name: Answer(*answer) for name, answer in json.loads(done.stdout).items()}


@pytest.mark.parametrize("name", commands(Path()))
def test_a_command_works_without_torch(name, answers):
    answer = answers[name]
    assert answer.status == 0, answer.error + answer.out
    assert not answer.asked, "torch was asked for"


def test_a_method_that_needs_torch_says_so(folder):
    """And shows that the others really went without."""
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "PRBENCH_CACHE": str(folder / "cache")}
    words = [
        "run",
        "--method",
        "mdm",
        "--condition",
        "text",
        "--data",
        str(folder / "table"),
        "--out",
        str(folder / "m"),
    ]
    done = subprocess.run([sys.executable, "-m", "prbench", *words], capture_output=True, text=True, env=environment)
    assert done.returncode not in (0, 1), done.stdout
    assert "No module named 'torch'" in done.stderr
    assert "Traceback" not in done.stderr


def test_scores_are_those_of_a_machine_with_torch(answers, folder):
    from prbench.harness.request import RunRequest
    from prbench.harness.run import run_method

    assert answers["static"].status == 0
    report = run_method(RunRequest(method="static", data=(folder / "table",), limit=4, out=folder / "runs" / "here"))
    for file in ("scores.parquet", "summary.json"):
        assert (folder / "runs/static/synthetic-adt" / file).read_bytes() == (
            report.folder.path / "synthetic-adt" / file
        ).read_bytes()
    assert np.isfinite([item.mean for item in report.summaries[0].metrics if item.mean is not None]).all()
