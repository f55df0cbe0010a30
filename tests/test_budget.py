"""The product stays small: its lines of code and words of documentation are counted against ``[tool.prbench.budget]``.

Raising a number in pyproject.toml needs a line with the reason in CONTRIBUTING.md, "The budget".
"""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("prbench", "adapters", "benchmarks", "data_manifests")
BUDGET = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["prbench"]["budget"]
FOUND = [*ROOT.glob("*.md"), *(path for folder in ("docs", *FOLDERS) for path in (ROOT / folder).rglob("*.md"))]
PAGES = [path for path in FOUND if "node_modules" not in path.parts]  # npm puts packages beside the example programs


def code_lines(source: str) -> int:
    """Count the lines of a module that are neither blank, nor comments, nor docstrings."""
    documentation: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                documentation.update(range(first.lineno, first.end_lineno + 1))
    return sum(
        bool(line.strip()) and not line.strip().startswith("#") and number not in documentation
        for number, line in enumerate(source.splitlines(), 1)
    )


def is_core(path: Path) -> bool:
    """Return True for modules of ``prbench/`` that are neither synthetic recordings nor checks."""
    parts = path.relative_to(ROOT).parts
    synthetic = parts[1] == "readers" and any(part.startswith("synthetic") for part in parts[2:])
    return parts[0] == "prbench" and parts[1] not in ("synthetic", "checking") and not synthetic


@pytest.fixture(scope="module")
def counted() -> dict[str, int]:
    """Count what the budget limits."""
    modules = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    lines = {path: code_lines(path.read_text(encoding="utf-8")) for path in modules}
    return {
        "code_lines": sum(lines.values()),
        "core_code_lines": sum(count for path, count in lines.items() if is_core(path)),
        "words": sum(len(path.read_text(encoding="utf-8").split()) for path in PAGES),
    }


@pytest.mark.parametrize("limited", ["code_lines", "core_code_lines", "words"])
def test_the_product_is_no_larger_than_its_budget(limited, counted):
    assert counted[limited] <= BUDGET[limited], (
        f"{limited}: {counted[limited]:,}, budget {BUDGET[limited]:,}. Take as much out as the change put in, or raise"
        " [tool.prbench.budget] in pyproject.toml with a line of reason in CONTRIBUTING.md."
    )


def test_docstrings_comments_and_blank_lines_are_no_code():
    assert (
        code_lines('"""A module\n\nof words."""\n\n# why\nx = 1\n\n\ndef f():\n    """Return 2."""\n    return 2\n')
        == 3
    )


def test_synthetic_recordings_and_checks_are_not_core():
    assert is_core(ROOT / "prbench/readers/adt/format.py")
    assert not is_core(ROOT / "prbench/readers/adt/synthetic/sensors.py")
    assert not is_core(ROOT / "prbench/checking/doctor/frame_rate.py")
    assert not is_core(ROOT / "adapters/static.py")
