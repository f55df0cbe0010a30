"""Which windows are scored, and which are learnt from: a published split, a dataset's own, or everybody left out once.

Source: docs/specification/motion-prediction.md#splits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int

from prbench.errors import UsageError
from prbench.sequences.table import by_share
from prbench_benchmarks.motion_prediction.table import WindowsTable

SplitChoice = Literal["published", "dataset", "participants"]
"""``published``: of the study; ``dataset``: of the recordings; ``participants``: each person scored once, unlearnt."""


@dataclass(frozen=True, eq=False)
class Fold:
    """Places of the windows of one part of an evaluation."""

    name: str
    """The participant who is left out; empty where there is one fold alone."""
    train: Int[np.ndarray, " m"]
    test: Int[np.ndarray, " n"]


def default_split(table: WindowsTable) -> SplitChoice:
    """The study's split where the table has one."""
    return "published" if "test" in set(table.runs["published_split"].to_pylist()) else "dataset"


def folds(table: WindowsTable, split: SplitChoice) -> Iterator[Fold]:
    """Choose the windows of an evaluation, the same for every predictor and condition.

    Args:
        table: The windows.
        split: Who is scored. A table may have windows for testing alone; then nothing can be learnt from it.

    Raises:
        UsageError: if no window is left for testing, or fewer than two participants are known.
    """
    if split == "participants":
        yield from _participants(table)
        return
    has_training = "train" in set(table.runs["published_split" if split == "published" else "split"].to_pylist())
    train = _part(table, split, "train") if has_training else np.zeros(0, dtype=np.int64)
    yield Fold("", train, _part(table, split, "test"))


def share_of(table: WindowsTable, places: Int[np.ndarray, " n"], limit: int | None) -> Int[np.ndarray, " m"]:
    """At most so many windows, of every recording its share; the same that `prbench run --limit` chooses."""
    if limit is None or limit >= len(places):
        return places
    ids = table.windows["window_id"].take(places).to_pylist()
    recordings = table.runs["recording_id"].take(table.windows["row"].take(places)).to_pylist()
    kept = set(by_share(ids, recordings)[:limit])
    return places[[name in kept for name in ids]]


def _part(table: WindowsTable, split: SplitChoice, part: str) -> Int[np.ndarray, " n"]:
    return table.chosen(published_split=part) if split == "published" else table.chosen(split=part)


def _participants(table: WindowsTable) -> Iterator[Fold]:
    everyone = sorted(set(table.runs["participant_id"].to_pylist()) - {"", "unknown"})
    if len(everyone) < 2:
        raise UsageError(
            f"{table.folder}: expected two participants or more to leave one out, found {len(everyone)}. Use the split"
            " of the dataset."
        )
    for left_out in everyone:
        others = [each for each in everyone if each != left_out]
        yield Fold(left_out, table.chosen(participants=others), table.chosen(participants=[left_out]))
