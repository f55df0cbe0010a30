"""The fixtures of tests that run methods."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from prbench.harness.methods import process
from tests.harness.methods.made_programs import Workshop
from tests.method_fixtures import install, own_cache, table

__all__ = ["install", "own_cache", "table"]


@pytest.fixture
def workshop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Workshop]:
    """Programs end faster than in earnest, and must be gone, threads included, when the test is over."""
    monkeypatch.setattr(process, "EXIT_SECONDS", 0.5)
    monkeypatch.setattr(process, "TERM_SECONDS", 0.3)
    made = Workshop.in_folder(tmp_path)
    yield made
    for adapter in made.started:
        adapter.close()
    until = time.monotonic() + 3
    while (made.left_behind() or _threads()) and time.monotonic() < until:
        time.sleep(0.02)
    left = made.left_behind()
    for leftover in left:
        leftover.kill()
    assert not left, "processes are left behind"
    assert not _threads(), "threads are left behind"


def _threads() -> list[str]:
    names = [thread.name for thread in threading.enumerate()]
    return [name for name in names if name.endswith("of a program") or name.startswith("log of")]
