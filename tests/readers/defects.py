"""What goes wrong with files on real disks or in real sensors, done to one recording of a sound tree."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from prbench.files.storage import write_json

Damage = Callable[[Path, str], object]
# One line of a CSV file by column.
Row = dict[str, str]


@dataclass(frozen=True)
class Defect:
    """One thing that goes wrong with files on real disks or in real sensors.

    Attributes:
        name: Lower case with dashes, for example ``missing-gaze``.
        what: What is wrong with the copy, in a few words.
        apply: Damages the recording of that id below the root of its tree, the same way each time.
        outcome: What a build must make of the recording: leave it out with a message, or read what is left of it.
        says: A part of the message that the user must see; empty where a repair needs no words.
    """

    name: str
    what: str
    apply: Damage
    outcome: Literal["failed", "skipped", "read"]
    says: str


def missing(name: str) -> Damage:
    """Return a damage that removes one file of the recording's folder."""
    return removed(lambda root, recording: root / recording / name)


def removed(find: Callable[[Path, str], Path]) -> Damage:
    """Return a damage that removes the file that ``find`` names for a tree and a recording."""
    return lambda root, recording: find(root, recording).unlink()


def cut_in_half(find: Callable[[Path, str], Path]) -> Damage:
    """Return a damage that drops the second half of a file, as a copy that stopped."""

    def apply(root: Path, recording: str) -> None:
        path = find(root, recording)
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])

    return apply


def change_json(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change the content of a JSON file in place."""
    content = json.loads(path.read_text())
    change(content)
    write_json(path, content)


def change_cells(path: Path, change: Callable[[list[list[str]]], Iterable[Iterable[str]]]) -> None:
    """Change the lines below the header of a CSV file, each a list of cells."""
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    rows = change([line.split(",") for line in lines])
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n", encoding="utf-8")


def changed_rows(text: str, change: Callable[[list[Row]], Iterable[Row]]) -> str:
    """Return the text of a CSV file with other rows below its header."""
    first, *lines = text.splitlines()
    header = first.split(",")
    rows = change([dict(zip(header, line.split(","), strict=True)) for line in lines])
    return "\n".join([first, *(",".join(row[column] for column in header) for row in rows)]) + "\n"
