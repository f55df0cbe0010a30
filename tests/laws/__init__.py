"""Laws that hold for everything that prbench makes, each tried by one parametrised test."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any


def listed(name: str) -> list[Any]:
    """Return the cases that the modules beside this one list under a name; each case has a name of its own."""
    modules = sorted(path.stem for path in Path(__file__).parent.glob("*_cases.py"))
    cases = [case for module in modules for case in getattr(importlib.import_module(f"tests.laws.{module}"), name, [])]
    names = [case.name for case in cases]
    repeated = sorted({each for each in names if names.count(each) > 1})
    assert not repeated, f"several cases of one name: {repeated}"
    return cases
