"""The study's printed figures for its sequences (*Prime and Reach*, Table 1 and Table S2)."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from importlib import resources


@dataclass(frozen=True)
class Spread:
    """Mean and standard deviation over sequences."""

    mean: float
    sd: float


QUANTITIES = {"duration": "s", "prime_gap": "s", "body_movement": "m", "hand_movement": "m"}
"""The four quantities of Table 1 and their units."""


@dataclass(frozen=True)
class PublishedRow:
    """One dataset in Table 1 and Table S2; seconds and metres."""

    sequences: int
    train: int
    test: int
    duration: Spread
    prime_gap: Spread
    body_movement: Spread
    hand_movement: Spread


@cache
def load_table_one() -> dict[str, PublishedRow]:
    """The published rows by dataset."""
    file = resources.files("prbench_benchmarks.prime_and_reach.published") / "table_1_and_s2.csv"
    lines = file.read_text(encoding="utf-8").splitlines()
    return {row["dataset"]: _row(row) for row in csv.DictReader(lines)}


def _row(row: dict[str, str]) -> PublishedRow:
    spreads = {name: Spread(float(row[f"{name}_mean"]), float(row[f"{name}_sd"])) for name in QUANTITIES}
    return PublishedRow(int(row["sequences"]), int(row["train"]), int(row["test"]), **spreads)
