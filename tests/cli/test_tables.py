"""Tables on the terminal."""

from __future__ import annotations

from prbench.cli.tables import print_table


def test_a_title_longer_than_its_table_stays_on_one_line(capsys) -> None:
    title = "Invented recordings in the layout of some dataset: from files to sequences"
    print_table(title, ("stage", "kept"), [("events", "6"), ("sequences", "12")], numbers=(1,))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == title
    assert lines[-2].split() == ["sequences", "12"]
    assert lines[-3].endswith(" 6 "), "numbers are set to the right"
