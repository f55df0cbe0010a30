"""Commands that are killed end, repeated, in the bytes of an undisturbed call, and leave nothing behind."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from prbench.cli.main import _parser
from tests.crashes import tried_by
from tests.writing import WRITING

WHERE = ("--out", "--draw", "--csv", "--json", "--gallery", "--histograms", "--view")
"""Options that say where a command writes."""


@pytest.mark.fuzz
@pytest.mark.skipif(not hasattr(os, "fork"), reason="crashes are tried in forked processes")
def test_every_command_that_writes_is_killed_before_some_of_its_file_operations(tmp_path: Path) -> None:
    assert tried_by("tests.cli.killed_commands", tmp_path) >= 18


def test_no_command_that_writes_is_forgotten() -> None:
    tried = {
        " ".join(word for word in writing.name.split(",")[0].split() if word not in _VARIANTS) for writing in WRITING
    }
    assert {f"{command} {option}" for command, option in _options(_parser()) if option in WHERE} <= tried | _PRINTED


_VARIANTS = {"png", "html", "mp4", "all", "nymeria", "--method"}
_PRINTED = {"adapters list --json"}
"""Options of the same name that write to the terminal."""


def _options(parser, name: str = "") -> list[tuple[str, str]]:
    found = [(name, option) for action in parser._actions for option in action.option_strings]
    for action in parser._actions:
        for word, child in (action.choices or {}).items() if isinstance(action.choices, dict) else ():
            found += _options(child, f"{name} {word}".strip())
    return found
