"""Every command that the README, a page of the documentation or a help page shows exists, with those flags."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.parsing import all_commands, parsed

ROOT = Path(__file__).parents[2]
PAGES = "\n".join(
    path.read_text(encoding="utf-8")
    for path in (
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs" / "methods").glob("*.md")),
    )
)


def _shown_commands() -> list[str]:
    blocks = re.findall(r"```bash\n(.*?)```", PAGES, re.DOTALL)
    shown = [line.split("&&")[-1] for block in blocks for line in block.splitlines()]
    shown += re.findall(r"`(prbench [^`]+)`", PAGES)
    shown += [command.example for command in all_commands().values()]
    commands = (re.split(r" {2,}|#", line.strip())[0].strip() for line in shown)
    return sorted({command for command in commands if command.startswith("prbench ")})


NAMED_ONLY = (
    ["adapters", "check"],
    ["analyse", "diversity"],
    ["analyse", "errors"],
    ["doctor"],
    ["view"],
    ["explain", "--draw"],
    ["export-release"],
    ["run"],
    ["train"],
    ["run", "--config"],
    ["COMMAND", "--help"],
)
"""Named in running text, without what they need."""


def test_commands_are_found() -> None:
    assert len(_shown_commands()) > 12


@pytest.mark.parametrize("command", _shown_commands())
def test_a_shown_command_parses(command, monkeypatch) -> None:
    words = shlex.split(command)[1:]
    if words in NAMED_ONLY or " ".join(words) in all_commands():
        return
    parsed(words[: words.index(">")] if ">" in words else words)


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_help_survives_a_console_that_lacks_characters(encoding) -> None:
    for words in ([], ["run"], ["score"], ["build-dataset"]):
        done = subprocess.run(
            [sys.executable, "-c", "from prbench.cli import main; raise SystemExit(main())", *words, "--help"],
            capture_output=True,
            env={**os.environ, "PYTHONIOENCODING": encoding},
        )
        assert done.returncode == 0, done.stderr
        assert b"Usage: prbench" in done.stdout
