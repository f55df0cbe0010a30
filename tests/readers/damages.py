"""Ways to damage a native file: each makes a function that changes the file of one name below a folder."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Damage = Callable[[Path], object]


def edit_lines(name: str, change: Callable[[list[str]], object]) -> Damage:
    """Change the list of lines of a text file in place; the file ends in a line break."""

    def damage(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        change(lines)
        (folder / name).write_text("\n".join(lines) + "\n")

    return damage


def edit_cells(name: str, line: int, change: Callable[[list[str]], list[str]]) -> Damage:
    """Change the cells of one line of a CSV file; line 1 is the header."""

    def changed(lines: list[str]) -> None:
        lines[line - 1] = ",".join(change(lines[line - 1].split(",")))

    return edit_lines(name, changed)


def set_cell(name: str, line: int, column: int, value: str) -> Damage:
    """Write one cell of a CSV file; line 1 is the header, columns count from 0."""
    return edit_cells(name, line, lambda cells: [*cells[:column], value, *cells[column + 1 :]])


def swap_lines(name: str, first: int, second: int) -> Damage:
    """Exchange two lines, counted from 1."""

    def changed(lines: list[str]) -> None:
        lines[first - 1], lines[second - 1] = lines[second - 1], lines[first - 1]

    return edit_lines(name, changed)


def keep_header(name: str) -> Damage:
    """Leave the first line alone."""
    return edit_lines(name, lambda lines: lines.__delitem__(slice(1, None)))


def swap_columns(name: str, first: str, second: str) -> Damage:
    """Exchange the values of two columns of a CSV file, whose header stays."""

    def changed(lines: list[str]) -> None:
        a, b = (lines[0].split(",").index(column) for column in (first, second))
        for row, line in enumerate(lines[1:], 1):
            cells = line.split(",")
            cells[a], cells[b] = cells[b], cells[a]
            lines[row] = ",".join(cells)

    return edit_lines(name, changed)


def edit_json(name: str, change: Callable[[Any], object]) -> Damage:
    """Change the content of a JSON file in place."""

    def damage(folder: Path) -> None:
        content = json.loads((folder / name).read_text())
        change(content)
        (folder / name).write_text(json.dumps(content))

    return damage


def edit_json_line(name: str, line: int, change: Callable[[Any], object]) -> Damage:
    """Change the record in one line of a JSON lines file in place; lines count from 1."""

    def changed(lines: list[str]) -> None:
        record = json.loads(lines[line - 1])
        change(record)
        lines[line - 1] = json.dumps(record)

    return edit_lines(name, changed)


def cut(name: str, count: int) -> Damage:
    """Remove the last bytes."""
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:-count])


def keep(name: str, count: int) -> Damage:
    """Keep the first bytes alone."""
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:count])


def remove(name: str) -> Damage:
    """Remove the file."""
    return lambda folder: (folder / name).unlink()


def write_text(name: str, text: str) -> Damage:
    """Write another text in its place."""
    return lambda folder: (folder / name).write_text(text)


def replace_text(name: str, old: str, new: str) -> Damage:
    """Replace a text that occurs in the file."""

    def damage(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return damage
