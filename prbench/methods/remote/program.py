"""How to start the program of a method: everything that is settled before it runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Program:
    """A method's program. Picklable, so that every worker can start its own; it knows nothing about tables."""

    name: str
    """What messages call it before it has introduced itself."""
    words: tuple[str, ...]
    """The whole command: a fence, ``conda run`` and the like included."""
    directory: Path | None
    """Where it starts; None for an empty temporary folder of its own."""
    environment: tuple[tuple[str, str], ...]
    """The whole environment; nothing is inherited beside it."""
    start_timeout: float = 120.0
    """Seconds until it has introduced itself."""
    batch_timeout: float = 600.0
    """Seconds until a batch is answered."""
    fence: str | None = None
    """None for the user's own program; ``process`` or ``bubblewrap`` for an installed method kept at a distance."""
