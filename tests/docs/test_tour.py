"""The guided tour runs as it is printed: its commands, its Python, and what that prints."""

from __future__ import annotations

import contextlib
import io
import re
import shlex

import pytest

from prbench.cli import main
from tests.test_architecture import ROOT

PAGE = (ROOT / "docs" / "tour.md").read_text(encoding="utf-8")


@pytest.mark.unchecked_shapes
def test_the_tour_prints_what_it_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    printed = ""
    compared = 0
    for language, block in re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL):
        if language == "sh":
            for line in block.splitlines():
                assert main(shlex.split(line)[1:]) == 0, capsys.readouterr().err
        elif language == "python":
            output = io.StringIO()
            with contextlib.redirect_stdout(output):
                exec(block, names)
            printed = output.getvalue()
        else:
            assert printed == block
            compared += 1
    assert compared == 9


def test_the_tour_is_short_and_its_files_exist():
    files = set(re.findall(r"`((?:prbench|benchmarks)/[\w/]+\.\w+)`", PAGE))
    assert [path for path in files if not (ROOT / path).is_file()] == []
    assert 10 <= len(files) <= 16
    assert len(PAGE.split()) <= 1500
