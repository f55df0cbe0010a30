"""Work that is killed ends, repeated, in the bytes of an undisturbed call, and leaves nothing behind."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.laws.killed import ONLY, tried_by
from tests.laws.killed_cases import KILLED, WRITING
from tests.parsing import all_commands

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills are tried in forked processes")
WHERE = ("--out", "--draw", "--fan", "--view")  # options that say where a command writes
_VARIANTS = {"png", "html", "mp4", "all", "nymeria", "--method"}


@pytest.mark.parametrize(
    "name", [pytest.param(each.name, marks=[pytest.mark.slow] if each.slow else []) for each in KILLED]
)
def test_a_function_is_killed_before_its_file_operations(name: str, tmp_path: Path) -> None:
    assert tried_by("check_function", tmp_path, name) > 10


@pytest.mark.fuzz
def test_every_command_that_writes_is_killed_before_some_of_its_file_operations(tmp_path: Path) -> None:
    assert tried_by("check_commands", tmp_path) >= (1 if ONLY in os.environ else 18)


@pytest.mark.fuzz
def test_builds_runs_shards_merges_and_trainings_are_killed_at_random_moments(tmp_path: Path) -> None:
    assert tried_by("check_at_random", tmp_path) >= 12


def test_no_command_that_writes_is_forgotten() -> None:
    tried = {" ".join(word for word in each.name.split(",")[0].split() if word not in _VARIANTS) for each in WRITING}
    options = [
        (name, flag) for name, command in all_commands().items() for each in command.params for flag in each.opts
    ]
    # It needs minutes of recordings, and writes each of its files as `analyse` and `explain` write theirs.
    tried.add("align --out")
    assert {f"{name} {flag}" for name, flag in options if flag in WHERE} <= tried
