"""Docstrings say what a thing is: no fragments such as "Of the protocol.", no words that readers stumbled over."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = sorted(path for folder in ("prbench", "adapters", "benchmarks") for path in (ROOT / folder).rglob("*.py"))
PAGES = sorted(path for path in (ROOT / "docs").rglob("*.md") if "node_modules" not in path.parts)

FRAGMENT = re.compile(r"(?:Of|As|Likewise|Where|In|For|With|At|From|By|On|Like|To|Per)\b")
"""How a description begins that says how something relates to another thing and not what it is."""

ARGUMENT = re.compile(r"\s+\*{0,2}\w[\w, *]*(?: \([^)]*\))?: (.*)")
"""A line of ``Args:`` or ``Attributes:``, and what it says."""

OPENING = re.compile(r"(?:Of|As|Likewise|The same|By|Where)\b")
"""How no docstring begins."""

WORDS = re.compile(
    r"\b(likewise|aforementioned|hereby|therein|whereof|clockwork|invented people|dearest)\b", re.IGNORECASE
)
"""Words that have a plainer one in the glossary, or none that a reader needs."""

HISTORY = re.compile(r"\b(since|until|before|in) (version )?0\.\d+\.\d\b|\bearlier versions?\b", re.IGNORECASE)
"""Words of history, which stands in the changelog alone."""


def docstrings(source: str) -> Iterator[tuple[str, str]]:
    """Every docstring of a module with the name of what it describes, attributes too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            name = getattr(node, "name", "module")
            strings = [
                each.value for each in node.body if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
            ]
            yield from ((name, each.value) for each in strings if isinstance(each.value, str))


def fragments(source: str) -> list[str]:
    """Lines of docstrings that do not say what the thing is."""
    found = []
    for name, text in docstrings(source):
        if OPENING.match(text) or WORDS.search(text):
            found.append(f"{name}: {text.splitlines()[0]}")
        for line in text.splitlines():
            argument = ARGUMENT.fullmatch(line)
            if argument and FRAGMENT.match(argument[1]):
                found.append(f"{name}: {line.strip()}")
    return found


def test_docstrings_say_what_a_thing_is():
    found = {str(path.relative_to(ROOT)): fragments(path.read_text(encoding="utf-8")) for path in MODULES}
    assert len(found) > 300
    assert {path: lines for path, lines in found.items() if lines} == {}


def test_pages_tell_no_history():
    found = {path.name: [match[0] for match in HISTORY.finditer(path.read_text(encoding="utf-8"))] for path in PAGES}
    assert {page: words for page, words in found.items() if words} == {}


@pytest.mark.parametrize(
    "docstring",
    [
        "Likewise.",
        "As the other.",
        "Read.\n\n    Args:\n        constants: Of the protocol.\n",
        "Draw the invented people.",
    ],
)
def test_a_fragment_would_be_noticed(docstring):
    assert fragments(f'def f(constants):\n    """{docstring}"""\n') != []
