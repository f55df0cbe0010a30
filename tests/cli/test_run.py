"""A method that leaves the process ends the command with a message and an exit code, not in silence with code 0."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from prbench.cli.run import calls_foreign_code, supervised
from prbench.errors import AdapterError
from tests.cli import ended_commands
from tests.fakes import fake_dataset

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("code", [0, 3])
def test_the_exit_code_of_a_command_that_returns_is_passed_on(code):
    assert supervised(ended_commands.returns, [str(code)], method="glide") == code


@pytest.mark.parametrize(
    ("command", "argument", "story"),
    [
        (ended_commands.leaves, "0", "ended with exit status 0"),
        (ended_commands.leaves_a_child_behind, "0", "ended with exit status 0"),
        (ended_commands.is_killed, "SIGKILL", "was ended by signal 9"),
    ],
)
def test_a_command_that_never_returns_is_an_error_of_the_method(command, argument, story):
    with pytest.raises(AdapterError, match=rf"method 'glide': the process that it ran in {story}.*no scores"):
        supervised(command, [argument], method="glide")


def test_a_request_to_stop_and_a_defect_keep_their_exit_codes(capfd):
    assert supervised(ended_commands.is_killed, ["SIGTERM"], method="glide") == 128 + 15
    assert supervised(ended_commands.raises, [], method="glide") == 1
    assert "a defect of prbench" in capfd.readouterr().err


def foreign(tmp_path: Path, body: str) -> Path:
    """A site folder with a package that offers the method ``leaves``."""
    info = tmp_path / "site" / "prbench_leaves-1.2.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: prbench_leaves\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text("[prbench.adapters]\nleaves = prbench_leaves:load\n")
    (info.parent / "prbench_leaves.py").write_text(body)
    return info.parent


LEAVES = """
import os
from prbench.contract import Condition

class Leaves:
    name = "leaves"
    conditions = frozenset(Condition)

    def generate(self, batch, *, seed):
        os._exit(0)

def load(weights, *, options, device):
    return Leaves()
"""


def test_only_methods_of_other_packages_that_run_in_this_process_are_supervised(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(foreign(tmp_path, LEAVES)))

    assert calls_foreign_code("leaves", isolate=False)
    assert not calls_foreign_code("leaves", isolate=True)
    for other in ("pr", "ground-truth", "cmd:python leaves.py"):
        assert not calls_foreign_code(other, isolate=False)


def test_os_exit_in_generate_ends_a_run_with_a_message_and_the_code_of_a_broken_contract(tmp_path):
    table = fake_dataset(tmp_path / "table", 8)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(foreign(tmp_path, LEAVES)), str(ROOT)])}
    words = ["run", "--method", "leaves", "--condition", "none"]
    words += ["--data", str(table.folder), "--out", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-m", "prbench", *words], capture_output=True, text=True, env=environment, timeout=120
    )
    assert done.returncode == 5, done.stderr
    assert "prbench: method 'leaves': the process that it ran in ended with exit status 0" in done.stderr
