"""Small copies of HD-EPIC for tests: a synthetic tree of two videos, and ways to change its files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from prbench.readers.hd_epic import format as hd_epic
from prbench.synthetic.people.perform import name_of_recording
from prbench.synthetic.write_tree import synthesize_tree

SEED = 3
FIRST, SECOND = (name_of_recording("hd-epic", SEED, index) for index in (0, 1))


def write_copy(root: Path) -> Path:
    synthesize_tree("hd-epic", root, recordings=2, seed=SEED, n_events=2, provocations={})
    return root


def annotation(root: Path, name: str) -> Path:
    return root / hd_epic.ANNOTATIONS_FOLDER / hd_epic.MOVEMENTS_FOLDER / name


def change_json(path: Path, change: Callable[[Any], None]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def time_file(root: Path, video: str) -> Path:
    (path,) = root.glob(f"HD-EPIC/Videos/*/{video}{hd_epic.TIME_SUFFIX}")
    return path
