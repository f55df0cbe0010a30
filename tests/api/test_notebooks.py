"""The notebooks and the code of docs/python-api.md run from an empty folder."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

import prbench

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.py"))
PAGE = ROOT / "docs" / "python-api.md"


_MARKER = re.compile(r"^# %%.*$", re.MULTILINE)


def cells(path: Path) -> list[tuple[str, str]]:
    """Kind (``code`` or ``markdown``) and text of each cell; what stands before the first one is the header."""
    text = path.read_text(encoding="utf-8")
    marks = list(_MARKER.finditer(text))
    ends = [mark.start() for mark in marks[1:]] + [len(text)]
    return [
        ("markdown" if "[markdown]" in mark.group() else "code", text[mark.end() : end].strip("\n"))
        for mark, end in zip(marks, ends, strict=True)
    ]


def run_notebook(path: Path) -> list[tuple[object, str | bytes]]:
    """Execute all cells and return what they show: the last value of a cell, and the form in which Jupyter shows it."""
    namespace: dict[str, object] = {"__name__": "__main__"}
    found = []
    for kind, text in cells(path):
        if kind == "markdown":
            continue
        body = ast.parse(text).body
        last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
        exec(compile(ast.Module(body, []), str(path), "exec"), namespace)
        if last is None:
            continue
        value = eval(compile(ast.Expression(last.value), str(path), "eval"), namespace)
        if value is not None:
            found.append((value, shown(value)))
    return found


def shown(value: object) -> str | bytes:
    """The richest form of a value that a notebook shows."""
    for name in ("_repr_html_", "_repr_png_"):
        if hasattr(value, name):
            return getattr(value, name)()
    return repr(value)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch) -> Path:
    """The current folder, and the one for temporary files."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_there_are_three_notebooks_and_the_page_names_them():
    names = [path.stem for path in NOTEBOOKS]
    assert names == ["from-a-recording-to-a-table", "look-at-one-event", "score-my-own-motions"]
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"notebooks/{name}.py" in text for name in names)


@pytest.mark.slow
@pytest.mark.unchecked_shapes
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_show_something(path, elsewhere):
    shown = run_notebook(path)
    assert len(shown) >= 5
    assert any(type(value).__module__.startswith("prbench") for value, _ in shown)
    assert any(isinstance(form, bytes) or "<table" in form for _, form in shown)
    assert all(form for _, form in shown)
    text = [line for kind, text in cells(path) if kind == "markdown" for line in text.splitlines()]
    assert len(text) >= 5
    assert all(line.startswith("#") or not line for line in text), "text in a cell stands in comments"


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS[:1], ids=lambda path: path.stem)  # the code of all has run above
def test_notebooks_run_as_scripts(path, elsewhere):
    environment = {**os.environ, "TMPDIR": str(elsewhere)}
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, env=environment, cwd=elsewhere)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS[1:2], ids=lambda path: path.stem)
@pytest.mark.skipif(
    not all(importlib.util.find_spec(name) for name in ("jupytext", "nbclient", "ipykernel")),
    reason="needs jupytext, nbclient and ipykernel",
)
def test_notebooks_run_in_jupyter(path, elsewhere, monkeypatch):
    import jupytext
    from nbclient import NotebookClient

    monkeypatch.setenv("TMPDIR", str(elsewhere))
    notebook = jupytext.read(path)
    NotebookClient(notebook, timeout=300, kernel_name="python3").execute(cwd=str(elsewhere))
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    forms = {form for output in outputs for form in output.get("data", {})}
    assert "text/html" in forms
    assert {"image/png", "text/html"} & forms
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]


@pytest.mark.unchecked_shapes
def test_the_code_of_the_page_runs(elsewhere):
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) >= 7
    namespace: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), namespace)
    assert {"sequence.png", "story.png", "run.png"} <= {path.name for path in elsewhere.iterdir()}
    measures = namespace["measures"]
    assert isinstance(measures, prbench.Measures)
    assert set(measures.left_out) == {"prime_success", "foot_skating"}


def test_every_name_of_the_page_is_there():
    text = PAGE.read_text(encoding="utf-8")
    for name in re.findall(r"`prbench\.(\w+)", text):
        assert hasattr(prbench, name), name
    for pattern in (r"`(sequence)\.(\w+)", r"`(table)\.(\w+)"):
        kind = {"sequence": prbench.Sequence, "table": prbench.Table}
        for owner, attribute in re.findall(pattern, text):
            known = {*dir(kind[owner]), *getattr(kind[owner], "__dataclass_fields__", ())}
            assert attribute in known, attribute
