"""What Python and the command line make alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import prbench
from prbench.cli import main
from prbench.synthetic.write_tree import synthesize_tree
from tests.fakes import fake_dataset
from tests.laws.cases import SameBytes
from tests.shared import made_once


def _table() -> Path:
    return made_once("laws-api-table", lambda out: fake_dataset(out, 24) and None)


def _recordings() -> Path:
    return made_once("laws-api-adt", lambda out: synthesize_tree("adt", out, recordings=2, seed=3, n_events=4) and None)


def _run(folder: Path) -> None:
    prbench.run("scripted", condition="goal-loc", data=_table(), limit=6, out=folder / "run")


def _run_by_command(folder: Path) -> None:
    words = ["run", "--method", "scripted", "--condition", "goal-loc", "--limit", "6", "--data", str(_table())]
    assert main([*words, "--out", str(folder / "run")]) == 0


def _build(folder: Path) -> None:
    prbench.build_dataset("adt", _recordings(), folder / "table")


def _build_by_command(folder: Path) -> None:
    assert main(["build-dataset", "adt", "--root", str(_recordings()), "--out", str(folder / "table")]) == 0


def _scores(folder: Path, workers: int = 1) -> list[float]:
    del folder
    table = prbench.open_table(_table())
    motions = {name: table.sequence(name).joints + np.float32(0.01) for name in table.sequence_ids(split="test")}
    return prbench.score(motions, table, workers=workers).to_pandas().value.tolist()


SAME_BYTES = [
    SameBytes("a run", {"in Python": _run, "by the command": _run_by_command}, unequal=("cost.json",)),
    SameBytes("a build", {"in Python": _build, "by the command": _build_by_command}),
    SameBytes("scores", {"in one process": _scores, "in two": lambda folder: _scores(folder, workers=2)}),
]
