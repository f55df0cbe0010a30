"""A leaderboard as Markdown, CSV (one number a row, like the published tables) or JSON."""

from __future__ import annotations

from collections.abc import Callable

from prbench.errors import UsageError
from prbench.leaderboard.as_csv import as_csv
from prbench.leaderboard.as_json import as_json
from prbench.leaderboard.as_markdown import as_markdown
from prbench.leaderboard.tables import Leaderboard

FORMATS: dict[str, Callable[[Leaderboard], str]] = {"md": as_markdown, "csv": as_csv, "json": as_json}


def export(leaderboard: Leaderboard, format: str) -> str:
    """The leaderboard as text that ends in a newline.

    Args:
        leaderboard: Of :func:`prbench.leaderboard.tables.make_leaderboard`.
        format: ``md``, ``csv`` or ``json``.

    Raises:
        UsageError: for another format.
    """
    if format not in FORMATS:
        raise UsageError(f"unknown format '{format}'; known ones are: {', '.join(FORMATS)}.")
    return FORMATS[format](leaderboard)
