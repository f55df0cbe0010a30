"""What a command starts is found as a shell would find it; if it is not there, the answer says what may be meant."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from prbench.errors import UsageError
from prbench.methods.programs.executables import find_executable, require_script

pytestmark = pytest.mark.skipif(os.name == "nt", reason="makes programs as POSIX systems have them")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """``bin/glide`` and ``bin/walk`` can be executed, ``glide.py`` and ``notes`` cannot."""
    (tmp_path / "bin").mkdir()
    for name in ("bin/glide", "bin/walk", "glide.py", "notes"):
        (tmp_path / name).write_text("#!/bin/sh\n")
        (tmp_path / name).chmod(0o755 if name.startswith("bin/") else 0o644)
    return tmp_path


def found(folder: Path, word: str) -> str:
    return find_executable(word, directory=folder, path=str(folder / "bin"), where="here")


def test_a_name_is_looked_up_in_path_and_a_path_in_the_directory(folder):
    assert found(folder, "glide") == found(folder, "bin/glide") == found(folder, "./bin/../bin/glide")
    assert found(folder, "glide") == str(folder / "bin/glide")


def test_a_path_may_begin_at_home(folder, monkeypatch):
    monkeypatch.setenv("HOME", str(folder))
    assert found(folder / "bin", "~/bin/walk") == str(folder / "bin/walk")


@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("glid", "the program 'glid' was not found. Did you mean 'glide'?"),
        ("bin/wallk", "found none. Did you mean 'walk'?"),
        ("glide.py", 'not found. Did you mean cmd:"python glide.py"?'),
        ("./glide.py", 'not one that can be executed. Start it with its interpreter: cmd:"python ./glide.py".'),
        ("notes", "not found. Did you mean ./notes?"),
        ("zzzzzzzzz", "It is looked up in the folders of PATH."),
    ],
)
def test_a_program_that_is_not_there_is_answered_with_what_may_be_meant(folder, word, answer):
    with pytest.raises(UsageError) as error:
        found(folder, word)
    assert answer in str(error.value)


def test_a_script_that_is_not_there_is_answered_with_the_nearest_file(folder):
    require_script(("python", "glide.py"), directory=folder, where="here")
    require_script(("python", "-m", "glide"), directory=folder, where="here")
    with pytest.raises(UsageError, match=r"expected the file glid\.py in .*, found none\. Did you mean 'glide\.py'\?"):
        require_script(("python", "glid.py"), directory=folder, where="here")
