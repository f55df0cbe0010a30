"""Fences to run a method behind: each that this machine has."""

from __future__ import annotations

import shutil

import pytest

from prbench.evaluation.isolation import available_fence


@pytest.fixture
def bubblewrap() -> None:
    """Skips where bubblewrap does not work."""
    fence = available_fence()
    if fence.kind != "bubblewrap":
        pytest.skip(fence.reason)


@pytest.fixture
def no_bubblewrap(monkeypatch: pytest.MonkeyPatch):
    """A machine without bubblewrap."""
    available_fence.cache_clear()
    which = shutil.which
    monkeypatch.setattr(
        shutil, "which", lambda name, *args, **kwargs: None if name == "bwrap" else which(name, *args, **kwargs)
    )
    yield
    available_fence.cache_clear()


@pytest.fixture(params=["process", "bubblewrap"])
def fence(request: pytest.FixtureRequest) -> str:
    """Both kinds, one after the other."""
    request.getfixturevalue("bubblewrap" if request.param == "bubblewrap" else "no_bubblewrap")
    return request.param
