"""``synthetic.json``: what marks a folder of native files as invented.

Source: docs/specification/synthetic-recordings.md#native-layouts.

Nothing else of the truth is ever read: the folder ``truth/`` beside it is for checking results only.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Literal

import msgspec

from prbench.datasets import SYNTHETIC_PREFIX
from prbench.errors import InputFileError
from prbench.readers.files import decode_json
from prbench.readers.found import is_present

SYNTHETIC_FILE = "synthetic.json"
_SYNTHETIC_NAME = re.compile(r"_synthetic_seed\d+_|_invented_a\d+_")
"""Stands in the name of every invented recording."""


class SyntheticTree(msgspec.Struct, frozen=True, kw_only=True):
    """Origin and splits of a synthetic tree."""

    generator: str
    version: int
    seed: int
    preset: str
    world: Literal["default", "large"]
    split: dict[str, Literal["train", "validation", "test"]]
    """Split of each recording, by id."""


_TREE = msgspec.json.Decoder(SyntheticTree)


def read_synthetic_tree(root: Path) -> SyntheticTree | None:
    """The mark of a synthetic tree: in ``root``, or beside it if ``root`` is one of its recordings.

    Returns:
        None for a folder of real recordings.

    Raises:
        InputFileError: if the mark is damaged.
    """
    for folder in (root, root.parent):
        if is_present(folder / SYNTHETIC_FILE):
            return decode_json(folder / SYNTHETIC_FILE, _TREE)
    return None


def synthetic_tree_around(folder: Path, root: Path) -> SyntheticTree | None:
    """The mark that a recording's folder lies under: the nearest one on the way up to ``root``, or beside it.

    Roots may be given one level too high; what is invented has to keep its name and splits there, too.

    Raises:
        InputFileError: if the mark is damaged.
    """
    way = [place for place in (folder, *folder.parents) if place.is_relative_to(root)]
    return next((tree for tree in map(read_synthetic_tree, (*way, root)) if tree is not None), None)


def lacks_mark(recording_id: str, dataset: str) -> bool:
    """Return True for an invented recording that would pass as a real one, because its mark was not copied."""
    return _SYNTHETIC_NAME.search(recording_id) is not None and not dataset.startswith(SYNTHETIC_PREFIX)


def require_marked(root: Path, recordings: Mapping[str, str]) -> None:
    """Refuse invented recordings that were copied without their mark: they would pass as real ones.

    Args:
        root: The folder that was searched.
        recordings: Name of the dataset of each recording, by the recording's name.

    Raises:
        InputFileError: naming one of them.
    """
    for name, dataset in recordings.items():
        if lacks_mark(name, dataset):
            raise InputFileError(
                root,
                "",
                expected=f"{SYNTHETIC_FILE} beside recordings whose names say that they are invented",
                found=f"{name} without it",
                remedy=f"Copy {SYNTHETIC_FILE} of the tree that they come from, too.",
            )


def require_one_origin(root: Path, datasets: Iterable[str]) -> None:
    """Refuse a folder in which real and invented recordings lie together: one table may not mix them.

    Raises:
        InputFileError: if the names of the recordings' datasets differ.
    """
    names = sorted(set(datasets))
    if len(names) > 1:
        raise InputFileError(
            root,
            "",
            expected="recordings that are all real or all invented",
            found=f"{' and '.join(names)} together",
            remedy=f"Give a folder that holds one of them; {SYNTHETIC_FILE} marks what is invented.",
        )
