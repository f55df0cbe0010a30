"""The page about the release names every inference, every kind of field, and commands that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from prbench.release.importing import import_release
from tests.parsing import all_commands, parsed
from tests.release.releases import rows, write_release

PAGE = (Path(__file__).parents[2] / "docs" / "release.md").read_text(encoding="utf-8")


def test_every_inference_is_explained(tmp_path) -> None:
    write_release(tmp_path / "release", rows(6))
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").tables[0]
    explained = set(re.findall(r"^\| `(\w+)` \|", PAGE.split("## What an imported table")[0], re.MULTILINE))
    assert {each.name for each in report.inferred} == explained


@pytest.mark.parametrize("line", re.findall(r"^prbench (.*?)(?:  +#.*)?$", PAGE, re.MULTILINE))
def test_its_commands_exist(line) -> None:
    assert parsed(line.split()).params["out"]


def test_options_it_names_exist() -> None:
    known = {
        option
        for name in ("import-release", "export-release", "explain")
        for parameter in all_commands()[name].params
        for option in parameter.opts
    }
    named = set(re.findall(r"(--[a-z][a-z-]+)", PAGE))
    assert named
    assert named - known == set()
