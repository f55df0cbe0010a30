"""``synthetic.json``: what marks a folder of native files as invented (``methods/synthetic-recordings.md`` section 14).

Nothing else of the truth is ever read: the folder ``truth/`` beside it is for checking results only.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from prbench.readers.files import decode_json

SYNTHETIC_FILE = "synthetic.json"
SYNTHETIC_PREFIX = "synthetic-"


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
        if (folder / SYNTHETIC_FILE).is_file():
            return decode_json(folder / SYNTHETIC_FILE, _TREE)
    return None
