"""How long work says how far it has got."""

from __future__ import annotations

from collections.abc import Callable

ProgressCallback = Callable[[int, int, str], None]
"""Called with finished items, all items, and what they are."""


def silent(done: int, total: int, what: str) -> None:
    """Say nothing."""
