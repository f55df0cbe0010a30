"""What all timing programs share: the clock and the printed table."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Row:
    """One timed way of doing the work."""

    name: str
    seconds: float | None
    """None where it could not be timed; the name says why."""


def timed(work: Callable[[], object], repeats: int) -> float:
    """Shortest duration of some repetitions after a first one that warms up, seconds."""
    work()
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        durations.append(time.perf_counter() - start)
    return min(durations)


def print_rows(title: str, rows: Sequence[Row]) -> None:
    """Print seconds and ratios; the first row is ours, and every ratio is against it."""
    ours = rows[0].seconds
    assert ours is not None, "the first row is timed"
    table = Table(title=title, title_justify="left")
    for column in ("", "seconds", "times ours"):
        table.add_column(column, justify="left" if not column else "right")
    for row in rows:
        cells = ("–", "–") if row.seconds is None else (f"{row.seconds:.4f}", f"{row.seconds / ours:.2f}")
        table.add_row(row.name, *cells)
    Console(width=110).print(table)
