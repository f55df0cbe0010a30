"""The page about corpora names every column, and no other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from prbench.sequences.corpus import ANNOTATION_OUTCOMES, ANNOTATIONS, CLIPS, CORPUS_RECORDINGS

PAGE = (Path(__file__).parents[3] / "docs" / "corpus.md").read_text(encoding="utf-8")


def _columns(section: str) -> set[str]:
    text = PAGE.split(f"\n## {section}\n", 1)[1].split("\n## ")[0]
    cells = [line.split("|")[1] for line in text.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


@pytest.mark.parametrize(
    ("section", "columns"),
    [
        ("clips", set(CLIPS.names)),
        ("annotations", set(ANNOTATIONS.names)),
        (
            "recordings",
            set(CORPUS_RECORDINGS.names) - set(ANNOTATION_OUTCOMES) | {ANNOTATION_OUTCOMES[0], ANNOTATION_OUTCOMES[-1]},
        ),
    ],
)
def test_every_column_is_explained(section, columns):
    assert _columns(section) == columns


def test_every_outcome_is_listed():
    assert all(f"`{outcome}`" in PAGE for outcome in ANNOTATION_OUTCOMES)
