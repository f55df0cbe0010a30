"""Programs see the environment as the user made it, under ``check`` as under ``run``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
import venv
from pathlib import Path

import pytest

from prbench.harness.methods.process import python_words

_DUMPS = "import json, os, sys; json.dump(dict(os.environ), open(sys.argv[1], 'w')); sys.exit(3)"
_ADDED_BY_INTERPRETERS = {"LC_CTYPE", "__CF_USER_TEXT_ENCODING"}


def prbench(*words: str, environment: dict[str, str], folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "prbench", *words]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=100)


@pytest.fixture
def mine(tmp_path: Path) -> dict[str, str]:
    """The environment of a user who has set nothing for Python, but a variable of their own and one of prbench's."""
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "SYSTEMROOT", "TEMP", "TMP") if name in os.environ}
    return kept | {"MY_BODY_MODELS": "/models", "PRBENCH_CACHE": str(tmp_path / "cache")}


@pytest.mark.parametrize("command", ["check", "run"])
def test_a_program_gets_the_users_variables_and_no_others(command, mine, tmp_path, table):
    (tmp_path / "dumps.py").write_text(_DUMPS)
    method = f'cmd:"{sys.executable}" dumps.py seen.json'
    words = ["adapters", "check", method] if command == "check" else [
        "run", "--method", method, "--condition", "none", "--data", str(table.folder), "--out", "run"
    ]  # fmt: skip
    done = prbench(*words, environment=mine, folder=tmp_path)
    assert "exit status 3" in done.stdout + done.stderr
    seen = json.loads((tmp_path / "seen.json").read_text())
    expected = {name: value for name, value in mine.items() if not name.startswith("PRBENCH_")}
    assert {name: value for name, value in seen.items() if name not in _ADDED_BY_INTERPRETERS} == expected


def test_a_package_that_an_environment_lacks_is_missed_by_check(mine, tmp_path):
    venv.create(tmp_path / "empty", with_pip=False)
    (tmp_path / "needs.py").write_text("import numpy\n")
    (tmp_path / "needs.toml").write_text(
        textwrap.dedent("""
            [method]
            command = "python needs.py"
            [environment]
            virtual-environment = "empty"
        """)
    )
    done = prbench("adapters", "check", "needs.toml", environment=mine, folder=tmp_path)
    assert done.returncode == 5
    assert "No module named 'numpy'" in done.stdout


def test_a_module_started_apart_finds_what_this_process_finds(tmp_path, monkeypatch):
    (tmp_path / "only_here.py").write_text(
        "import os, sys; print(sys.argv[1], sys.path[0], 'PYTHONPATH' in os.environ)"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    done = subprocess.run(python_words("only_here", "word"), capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["word", str(tmp_path), "False"]
