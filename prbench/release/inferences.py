"""What an import found out by itself: value, evidence, and how surely."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Certainty = Literal["certain", "likely", "assumed", "unknown"]
"""Stated by the data or the user and confirmed; measured with room for doubt; taken for granted; not found out."""


@dataclass(frozen=True)
class Inference:
    """One thing that the release does not say outright."""

    name: str
    value: str
    certainty: Certainty
    evidence: str

    @property
    def text(self) -> str:
        """One line, as it stands among the options of ``dataset.json``."""
        return f"{self.value} ({self.certainty}: {self.evidence})"


@dataclass(frozen=True)
class FieldChoice:
    """Which field of the release stands for a canonical one."""

    canonical: str
    field: str
    certainty: Certainty
    evidence: str


@dataclass(frozen=True)
class Problem:
    """What is wrong with one sequence."""

    key: str
    message: str
    left_out: bool
    """The sequence was left out; else it was taken with what is said here."""


def grouped(problems: Iterable[Problem]) -> list[tuple[str, int, str]]:
    """Messages with how many sequences they concern and the first of them, the most frequent first."""
    counts: Counter[str] = Counter()
    first: dict[str, str] = {}
    for problem in problems:
        counts[problem.message] += 1
        first.setdefault(problem.message, problem.key)
    return [(message, count, first[message]) for message, count in counts.most_common()]
