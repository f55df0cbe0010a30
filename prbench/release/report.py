"""What an import found out by itself, and its report for people and as ``import_report.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from prbench.release.known import KnownDataset
from prbench.sequences import DatasetInfo
from prbench.storage import write_json

Certainty = Literal["certain", "likely", "assumed", "unknown"]
"""Stated by the data or the user and confirmed; measured with room for doubt; taken for granted; not found out."""
FILE_NAME = "import_report.json"


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


@dataclass(frozen=True)
class _CountRow:
    """Sequences of one split, beside what the study says."""

    split: str
    found: int
    expected: int | None
    """None where the study says nothing."""


@dataclass(frozen=True)
class ImportReport:
    """Everything that an import of one dataset inferred, and what it could not use."""

    dataset: str
    folder: Path
    """The table."""
    info: DatasetInfo
    shape: str
    fields: tuple[FieldChoice, ...]
    unmapped: tuple[str, ...]
    inferences: tuple[Inference, ...]
    problems: tuple[Problem, ...]
    counts: tuple[_CountRow, ...]
    warnings: tuple[str, ...]

    @property
    def left_out(self) -> int:
        """Number of sequences that could not be taken."""
        return len({problem.key for problem in self.problems if problem.left_out})

    def write(self) -> None:
        """Write ``import_report.json`` beside ``dataset.json``; it holds no time of day and no absolute path."""
        write_json(self.folder / FILE_NAME, self.as_json())

    def as_json(self) -> dict[str, Any]:
        """The report as JSON."""
        return {
            "dataset": self.dataset,
            "shape_of_target_information": self.shape,
            "fields": [
                {"means": each.canonical, "field": each.field, "how_surely": each.certainty, "evidence": each.evidence}
                for each in self.fields
            ],
            "fields_kept_in_extra": list(self.unmapped),
            "inferred": [
                {"name": each.name, "value": each.value, "how_surely": each.certainty, "evidence": each.evidence}
                for each in self.inferences
            ],
            "counts": [{"split": row.split, "found": row.found, "study": row.expected} for row in self.counts],
            "warnings": list(self.warnings),
            "problems": [
                {"sequence": each.key, "problem": each.message, "left_out": each.left_out} for each in self.problems
            ],
        }

    def problem_lines(self, most: int = 12) -> list[str]:
        """Problems by kind, the most frequent first."""
        groups = grouped(self.problems)
        lines = [f"{count} × {message} (first: {key})" for message, count, key in groups[:most]]
        return lines + (
            [f"… and {len(groups) - most} more kinds; {FILE_NAME} lists them"] if len(groups) > most else []
        )


def count_rows(splits: Iterable[str], known: KnownDataset | None) -> tuple[_CountRow, ...]:
    """Sequences found by split, beside the study's."""
    found = Counter(splits)
    expected = {} if known is None else {"train": known.train, "test": known.test, "validation": 0}
    names = [name for name in ("train", "validation", "test") if found[name] or expected.get(name)]
    return tuple(_CountRow(name, found[name], expected.get(name)) for name in names)


def count_warnings(rows: Iterable[_CountRow]) -> tuple[str, ...]:
    """A sentence for each split whose count is not the study's; a later release may well differ."""
    return tuple(
        f"{row.split}: {row.found} sequences, the study has {row.expected}."
        for row in rows
        if row.expected is not None and row.found != row.expected
    )
