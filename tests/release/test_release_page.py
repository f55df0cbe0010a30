"""The page about the release names every inference, every kind of field, and commands that exist."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

import pytest

from prbench.cli.main import _parser
from prbench.release import import_release
from tests.release.releases import rows, write_release

PAGE = (Path(__file__).parents[2] / "docs" / "release.md").read_text(encoding="utf-8")


def test_every_inference_is_explained(tmp_path) -> None:
    write_release(tmp_path / "release", rows(6))
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").reports[0]
    explained = set(re.findall(r"^\| `(\w+)` \|", PAGE.split("## What an imported table")[0], re.MULTILINE))
    assert {each.name for each in report.inferences} == explained


@pytest.mark.parametrize("line", re.findall(r"^prbench (.*?)(?:  +#.*)?$", PAGE, re.MULTILINE))
def test_its_commands_exist(line) -> None:
    chosen = _parser().parse_args(line.split())
    assert callable(chosen.execute)


def test_options_it_names_exist() -> None:
    (commands,) = (action for action in _parser()._actions if isinstance(action, argparse._SubParsersAction))
    known = {
        option
        for name in ("import-release", "export-release", "explain")
        for action in commands.choices[name]._actions
        for option in action.option_strings
    }
    named = set(re.findall(r"(--[a-z][a-z-]+)", PAGE))
    assert named
    assert named - known == set()
