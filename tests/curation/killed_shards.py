"""Shards and merges that die at some of their file operations (run by the test in an interpreter of its own)."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow as pa

from prbench.curation import build_from_sources
from prbench.curation.build import build_shard_from_sources, merge_dataset_shards
from prbench.engine.shards import Shard, require_whole
from tests.crashes import in_a_child, operations
from tests.curation.sources import folder_bytes, some_sources

_STEP = 5
"""File operations between two kills; with seven kinds of files in a part, every kind is met."""


def build(folder: Path) -> None:
    """Make two shards and merge them."""
    for number in (1, 2):
        build_shard_from_sources(some_sources(3), folder / f"shard-{number}", Shard(number, 2))
    merge_dataset_shards(require_whole([folder / "shard-1", folder / "shard-2"]), folder / "adt", replace=False)


def check(folder: Path) -> int:
    """Some of them end with the bytes of an unsharded build once they are repeated; returns how many were tried."""
    pa.set_cpu_count(1)
    build_from_sources(some_sources(3), folder / "whole")
    (folder / "undisturbed").mkdir()
    count = operations(build, folder / "undisturbed")
    wanted = folder_bytes(folder / "undisturbed")
    assert folder_bytes(folder / "undisturbed" / "adt") == folder_bytes(folder / "whole")
    tried = 0
    for place in range(1, count, _STEP):
        left = folder / str(place)
        left.mkdir()
        assert in_a_child(build, left, dies_before=place), place
        in_a_child(build, left)
        assert folder_bytes(left) == wanted, left
        assert sorted(path.name for path in left.iterdir()) == ["adt", "shard-1", "shard-2"], left
        shutil.rmtree(left)
        tried += 1
    return tried
