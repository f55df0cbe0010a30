"""Runs a notebook in percent format without Jupyter: cell by cell, and each cell's last value is shown."""

from __future__ import annotations

import ast
import re
from pathlib import Path

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
