"""The method shown on the page of offline scoring runs as it stands there, and scores."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from prbench.cli import main
from prbench.harness.run_folder import DatasetSummary
from tests.fakes import fake_dataset

PAGE = (Path(__file__).parents[3] / "docs/offline.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def shown() -> str:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    return code


def test_the_method_needs_numpy_only_and_an_old_python_will_do(shown):
    tree = ast.parse(shown, feature_version=(3, 8))
    imported = [name.name for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names]
    assert imported == ["numpy"]
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]


def test_the_method_goes_from_conditions_to_scores(shown, table, tmp_path, capsys):
    other = fake_dataset(tmp_path / "other", 24, dataset="synthetic-gimo")
    data = ["--data", str(table.folder), str(other.folder)]
    conditions, predictions, out = (str(tmp_path / name) for name in ("conditions.npz", "predictions.npz", "scores"))
    exported = ["export-conditions", *data, "--condition", "goal-loc", "--samples", "3", "--out", conditions]
    assert main(exported) == 0
    assert "63 motions to generate" in capsys.readouterr().out

    (tmp_path / "generate.py").write_text(shown)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    subprocess.run([sys.executable, "generate.py"], cwd=tmp_path, env=environment, check=True)
    assert main(["score", predictions, "--conditions", conditions, *data, "--name", "glide", "--out", out]) == 0
    printed = capsys.readouterr().out
    assert (
        "Made up (synthetic): glide (file predictions.npz), condition goal-loc; 15 sequences of 3 recordings" in printed
    )
    sentence = "These are scores on synthetic data: never compare them with published ones."
    assert printed.count(sentence) == 2
    assert main(["run", "--method", "ground-truth", *data[:2], "--limit", "3", "--out", str(tmp_path / "one")]) == 0
    assert capsys.readouterr().out.count(sentence) == 1
    for dataset in ("synthetic-adt", "synthetic-gimo"):
        summary = DatasetSummary.read(tmp_path / "scores" / dataset)
        assert (summary.method, summary.condition, summary.samples) == ("glide", "goal-loc", 3)
    with np.load(predictions) as made, np.load(conditions) as given:
        assert np.array_equal(made["joints"][:, 0], given["initial_joints"])


def test_the_page_lists_the_arrays_that_there_are(table, tmp_path):
    for condition in ("goal-loc", "goal-pose"):
        path = tmp_path / f"{condition}.npz"
        assert (
            main(["export-conditions", "--data", str(table.folder), "--condition", condition, "--out", str(path)]) == 0
        )
        with np.load(path) as arrays:
            assert all(f"`{name}`" in PAGE for name in arrays.files)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["export-conditions", "--condition", "none", "--out", "{tmp}/c.csv"], 2, "ends in .npz"),
        (["score", "{tmp}/gone.npz"], 6, "gone.npz: expected an .npz file, found no file"),
        (["score", "{tmp}/gone.npz", "--conditions", "{tmp}/none.npz"], 3, "none.npz: expected an .npz file"),
        (["score", "{tmp}", "--name", " "], 2, "--name: expected a name of 1 to 100 characters"),
    ],
)
def test_a_mistake_gives_one_line_and_its_exit_code(table, tmp_path, capsys, arguments, code, message):
    words = [word.format(tmp=tmp_path) for word in arguments]
    assert main([*words, "--data", str(table.folder)]) == code
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert message in errors[0]
