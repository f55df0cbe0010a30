"""Tables that are built."""

from __future__ import annotations

from pathlib import Path

from prbench.curation import build_from_sources
from prbench.engine.pool import ProcessPool
from tests.curation.sources import some_sources
from tests.laws.cases import SameBytes


def _in_one_process(folder: Path) -> None:
    build_from_sources(some_sources(), folder / "table")


def _by_two_workers_from_the_last(folder: Path) -> None:
    build_from_sources(some_sources()[::-1], folder / "table", engine=ProcessPool(2))


SAME_BYTES = [
    SameBytes(
        "a table",
        {"in one process": _in_one_process, "by two workers, from the last": _by_two_workers_from_the_last},
        differs={"fewer recordings": lambda folder: build_from_sources(some_sources(2), folder / "table") and None},
    )
]
