"""Commands that are killed end, repeated, in the bytes of an undisturbed call, and leave nothing behind."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.crashes import tried_by
from tests.parsing import all_commands
from tests.writing import WRITING

WHERE = ("--out", "--draw", "--fan", "--view")
"""Options that say where a command writes."""


@pytest.mark.fuzz
@pytest.mark.skipif(not hasattr(os, "fork"), reason="crashes are tried in forked processes")
def test_every_command_that_writes_is_killed_before_some_of_its_file_operations(tmp_path: Path) -> None:
    assert tried_by("tests.cli.killed_commands", tmp_path) >= 18


@pytest.mark.fuzz
@pytest.mark.skipif(not hasattr(os, "fork"), reason="crashes are tried in forked processes")
def test_builds_runs_shards_merges_and_trainings_are_killed_at_random_moments(tmp_path: Path) -> None:
    assert tried_by("tests.cli.killed_commands", tmp_path, check="check_at_random") >= 12


def test_no_command_that_writes_is_forgotten() -> None:
    tried = {
        " ".join(word for word in writing.name.split(",")[0].split() if word not in _VARIANTS) for writing in WRITING
    }
    written = {f"{command} {option}" for command, option in _options() if option in WHERE}
    assert written <= tried


_VARIANTS = {"png", "html", "mp4", "all", "nymeria", "--method"}


def _options() -> list[tuple[str, str]]:
    """Every option of every command."""
    commands = all_commands().items()
    return [(name, option) for name, command in commands for each in command.params for option in each.opts]
