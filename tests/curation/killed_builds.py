"""Builds that die at each of their file operations (run by the resume test in an interpreter of its own)."""

from __future__ import annotations

import shutil
from pathlib import Path

from prbench.curation import build_from_sources
from tests.crashes import crashes, in_a_child
from tests.curation.sources import folder_bytes, some_sources


def build(folder: Path) -> None:
    build_from_sources(some_sources(2), folder / "adt")


def check(folder: Path) -> int:
    """All of them end with the bytes of an undisturbed one once they are repeated; returns how many were tried."""
    build(folder / "undisturbed")
    wanted, tried = folder_bytes(folder / "undisturbed" / "adt"), 0
    for left in crashes(build, folder / "killed"):
        in_a_child(build, left)
        assert folder_bytes(left / "adt") == wanted, left
        assert [path.name for path in left.iterdir()] == ["adt"], left
        shutil.rmtree(left)
        tried += 1
    return tried
