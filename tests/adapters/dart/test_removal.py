"""The method lives in its folder and in one line of ``pyproject.toml``: without both, nothing is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
OWN = ROOT / "adapters" / "dart"


def test_nobody_else_imports_it():
    for folder in ("prbench", "adapters"):
        for path in (ROOT / folder).rglob("*.py"):
            if OWN not in path.parents:
                assert "prbench_adapters.dart" not in path.read_text(encoding="utf-8"), path


def test_it_is_installed_by_one_line():
    lines = (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    assert [line for line in lines if "dart" in line] == ['dart = "prbench_adapters.dart:load"']


def test_importing_it_loads_neither_torch_nor_its_own_modules():
    code = "import sys, prbench_adapters.dart; print([n for n in sys.modules if n == 'torch' or 'adapters.dart.' in n])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
