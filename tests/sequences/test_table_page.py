"""The page about the tables names every column, and no other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest

from prbench.recording.streams import HandSource
from prbench.sequences.sequence import EVENTS, OUTCOMES, RECORDINGS, SCENES, SEQUENCES

PAGE = (Path(__file__).parents[2] / "docs" / "table.md").read_text(encoding="utf-8")


def _columns(section: str) -> set[str]:
    text = PAGE.split(f"\n## {section}\n", 1)[1].split("\n## ")[0]
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize(
    ("section", "columns"),
    [
        ("sequences", set(SEQUENCES.names)),
        ("events", set(EVENTS.names)),
        ("scenes", set(SCENES.names)),
        ("recordings", set(RECORDINGS.names) - set(OUTCOMES) | {OUTCOMES[0], OUTCOMES[-1]}),
    ],
)
def test_every_column_is_explained(section, columns):
    assert _columns(section) == columns


def test_every_outcome_is_listed():
    assert all(f"`{outcome}`" in PAGE for outcome in OUTCOMES)


def test_everything_that_tells_a_hand_is_explained():
    assert _columns("Which hand reached") == set(get_args(HandSource)) | {"hand_source"}
