"""Reports of long work on how far it has got."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """One step of the way through one dataset."""

    dataset: str
    stage: str
    """``generate`` (counted in planned batches) or ``score`` (in sequences)."""
    done: int
    total: int


ProgressCallback = Callable[[Progress], None]


def silent(progress: Progress) -> None:
    """Say nothing."""
