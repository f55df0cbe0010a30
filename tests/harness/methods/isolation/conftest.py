"""Fences to run a method behind: each that this machine has."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from prbench.harness.methods.isolation import available_fence


@pytest.fixture
def bubblewrap() -> None:
    """Skips where bubblewrap does not work."""
    fence = available_fence()
    if fence.program is None:
        pytest.skip(fence.reason)


@pytest.fixture
def no_bubblewrap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A machine, and all processes that a test starts on it, where bubblewrap is installed and does not work."""
    (tmp_path / "broken").mkdir()
    broken = tmp_path / "broken/bwrap"
    broken.write_text("#!/bin/sh\necho 'setting up uid map: Permission denied' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", f"{broken.parent}{os.pathsep}{os.environ['PATH']}")
    available_fence.cache_clear()
    yield
    available_fence.cache_clear()


@pytest.fixture(params=["process", "bubblewrap"])
def fence(request: pytest.FixtureRequest) -> str:
    """Both kinds, one after the other."""
    request.getfixturevalue("bubblewrap" if request.param == "bubblewrap" else "no_bubblewrap")
    return request.param
