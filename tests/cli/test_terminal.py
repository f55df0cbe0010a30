"""Tables on the terminal."""

from __future__ import annotations

import io
import re
import sys

import pytest
from rich.console import Console

from prbench.cli import terminal
from prbench.cli.commands import progress
from prbench.cli.terminal import clean_output, print_columns, print_table


def test_a_title_longer_than_its_table_stays_on_one_line(capsys) -> None:
    title = "Invented recordings in the layout of some dataset: from files to sequences"
    print_table(title, ("stage", "kept"), [("events", "6"), ("sequences", "12")], numbers=(1,))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == title
    assert lines[-2].split() == ["sequences", "12"]
    assert lines[-3].endswith(" 6 "), "numbers are set to the right"


def test_names_in_tables_are_neither_markup_nor_steering(capsys) -> None:
    print_table("of [red]x[/]\x1b[2J", ("name",), [("[bold]cup[/]",), ("cup\x1b]0;t\x07",)])
    printed = capsys.readouterr().out
    assert "\x1b" not in printed
    assert all(text in printed for text in ("of [red]x[/]\\x1b[2J", "[bold]cup[/]", "cup\\x1b]0;t\\x07"))


def test_a_table_on_a_terminal_keeps_its_own_style_under_clean_output(monkeypatch) -> None:
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with clean_output():
        sys.stdout.write("of\tours \x1b[31mred\n")
        print_table("title", ("name",), [("cup\x1b[31m",)])
    assert "of\tours \\x1b[31mred\n" in screen.getvalue()
    assert "\x1b[3mtitle" in screen.getvalue()
    assert "cup\\x1b[31m" in screen.getvalue()


def test_what_is_printed_elsewhere_is_clean_while_a_command_runs(capsys) -> None:
    with clean_output():
        sys.stderr.write("\x1b[2Jcup\r\u202e\n")
        with progress("reading") as show:
            show(1, 1, "P01\x1b[31m\nP02")
    assert capsys.readouterr().err == "\\x1b[2Jcup\\r\\u202e\nreading: 1/1 P01\\x1b[31m\\nP02\n"
    assert not hasattr(sys.stderr, "raw")


def shown_at(width: int, monkeypatch) -> str:
    """A table with a long name and numbers on a terminal so wide."""
    page = io.StringIO()
    monkeypatch.setattr(
        terminal,
        "console",
        lambda **_: Console(file=page, force_terminal=True, width=width, no_color=True, highlight=False, markup=False),
    )
    rows = [("synthetic-adt", "7.09 ± 2.85", "0.59 ± 0.17", "few recordings; all equal")]
    print_table("sequences", ("dataset", "duration s", "movement m", "remarks"), rows, numbers=(1, 2))
    return re.sub(r"\x1b\[[0-9;]*m", "", page.getvalue())


@pytest.mark.parametrize("width", [30, 40, 60, 70, 80, 200])
def test_neither_a_word_nor_a_number_is_broken_however_narrow_the_terminal(width, monkeypatch):
    page = shown_at(width, monkeypatch)
    for whole in ("synthetic-adt", "7.09 ± 2.85", "0.59 ± 0.17", "recordings;", "equal"):
        assert whole in page
    assert max(len(line.rstrip()) for line in page.splitlines()) <= width


def test_a_narrow_terminal_gets_one_line_a_cell(monkeypatch):
    assert "synthetic-adt\n  duration s: 7.09 ± 2.85\n  movement m: 0.59 ± 0.17\n" in shown_at(40, monkeypatch)
    assert "7.09 ± 2.85   0.59 ± 0.17   few recordings; all equal" in shown_at(200, monkeypatch)


def test_only_long_texts_are_folded(capsys):
    evidence = "seen in the files, which hold a number of this size in every entry " * 5
    print_table("inferred", ("", "value", "how surely", "evidence"), [("frame rate", "20", "assumed", evidence)])
    lines = capsys.readouterr().out.splitlines()
    assert any(line.split() == ["value", "how", "surely", "evidence"] for line in lines)
    assert max(len(line) for line in lines) <= 200


COLUMNS = ("name", "package", "target", "")
ROWS = [("static", "prbench", "prbench_adapters.static:load", ""), ("pr", "prbench", "prbench_adapters.pr:load", "! x")]


def test_columns_are_never_folded_in_a_file(capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    print_columns(COLUMNS, ROWS)
    assert capsys.readouterr().out.splitlines() == [
        "name    package  target",
        "static  prbench  prbench_adapters.static:load",
        "pr      prbench  prbench_adapters.pr:load      ! x",
    ]


def test_columns_become_blocks_on_a_terminal_that_is_too_narrow(monkeypatch) -> None:
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "45")
    print_columns(COLUMNS, ROWS)
    lines = [line.rstrip() for line in re.sub(r"\x1b\[[0-9;]*m", "", screen.getvalue()).splitlines()]
    assert "  target: prbench_adapters.static:load" in lines
    assert max(map(len, lines)) <= 45


def test_no_color_leaves_no_escape_sequence(monkeypatch):
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stdout", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    print_table("title", ("name",), [("cup",)])
    assert "cup" in screen.getvalue()
    assert "\x1b" not in screen.getvalue()
