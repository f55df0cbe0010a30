"""What an import did: fields, inferences, problems and counts, for people and as ``import_report.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from prbench.release.inferences import FieldChoice, Inference, Problem, grouped
from prbench.release.known import KnownDataset
from prbench.sequences import DatasetInfo
from prbench.storage import write_json

FILE_NAME = "import_report.json"


@dataclass(frozen=True)
class CountRow:
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
    counts: tuple[CountRow, ...]
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


def count_rows(splits: Iterable[str], known: KnownDataset | None) -> tuple[CountRow, ...]:
    """Sequences found by split, beside the study's."""
    found = Counter(splits)
    expected = {} if known is None else {"train": known.train, "test": known.test, "validation": 0}
    names = [name for name in ("train", "validation", "test") if found[name] or expected.get(name)]
    return tuple(CountRow(name, found[name], expected.get(name)) for name in names)


def count_warnings(rows: Iterable[CountRow]) -> tuple[str, ...]:
    """A sentence for each split whose count is not the study's; a later release may well differ."""
    return tuple(
        f"{row.split}: {row.found} sequences, the study has {row.expected}."
        for row in rows
        if row.expected is not None and row.found != row.expected
    )
