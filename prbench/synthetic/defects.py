"""Defects: what real copies of a dataset suffer from, done to one recording of a freshly written synthetic tree.

The defects of a layout are the ``DEFECTS`` of ``synthetic_defects.py`` in its reader's folder.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from prbench.errors import UsageError, did_you_mean
from prbench.files.storage import write_json

_CORPORA = {name: f"prbench.synthetic.{name}_defects" for name in ("nymeria", "humanml3d")}
Damage = Callable[[Path, str], None]
"""Damages the recording of that id below the tree's root; deterministic."""
Row = dict[str, str]
"""One line of a CSV file by column."""


@dataclass(frozen=True)
class Defect:
    """One thing that goes wrong with files on real disks or in real sensors."""

    name: str
    """Lower case with dashes, for example ``missing-gaze``."""
    what: str
    """One line for the help page."""
    apply: Damage
    outcome: Literal["failed", "skipped", "read"]
    """What a build must make of the recording: leave it out with a message, or read what is left of it."""
    says: str
    """A part of the message that the user must see; empty where a repair needs no words."""


def defects_of(preset: str) -> tuple[Defect, ...]:
    """Return all defects of a preset's layout."""
    module = _CORPORA.get(preset, f"prbench.readers.{preset.replace('-', '_')}.synthetic_defects")
    return importlib.import_module(module).DEFECTS


def defect(preset: str, name: str) -> Defect:
    """Return one defect by name.

    Raises:
        UsageError: for an unknown one, naming those there are.
    """
    known = {each.name: each for each in defects_of(preset)}
    if name not in known:
        hint = did_you_mean(name, known)
        raise UsageError(f"{preset} has no defect '{name}'.{hint} It has: {', '.join(known) or 'none'}.")
    return known[name]


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
