"""Tables on the terminal."""

from __future__ import annotations

import io
import sys

from prbench.cli.progress import progress
from prbench.cli.terminal import clean_output, print_table


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
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    with clean_output():
        sys.stdout.write("of\tours \x1b[31mred\n")
        print_table("title", ("name",), [("cup\x1b[31m",)])
    assert "of\tours \\x1b[31mred\n" in terminal.getvalue()
    assert "\x1b[3mtitle" in terminal.getvalue()
    assert "cup\\x1b[31m" in terminal.getvalue()


def test_what_is_printed_elsewhere_is_clean_while_a_command_runs(capsys) -> None:
    with clean_output():
        sys.stderr.write("\x1b[2Jcup\r\u202e\n")
        with progress("reading") as show:
            show(1, 1, "P01\x1b[31m\nP02")
    assert capsys.readouterr().err == "\\x1b[2Jcup\\r\\u202e\nreading: 1/1 P01\\x1b[31m\\nP02\n"
    assert not hasattr(sys.stderr, "raw")
