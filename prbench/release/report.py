"""The inferences and problems of an import, and its report for people and as ``import_report.json``.

The structures carry the names of the JSON's keys (``rename``), so that the file is written from them as they are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from prbench.files.storage import write_json
from prbench.release.known import KnownDataset
from prbench.sequences import DatasetInfo

Certainty = Literal["certain", "likely", "assumed", "unknown"]
"""In this order: stated and confirmed; measured with room for doubt; taken for granted; not found out."""
FILE_NAME = "import_report.json"


class Inference(msgspec.Struct, frozen=True, rename={"certainty": "how_surely"}):
    """One property that the release does not state."""

    name: str
    value: str
    certainty: Certainty
    evidence: str

    @property
    def text(self) -> str:
        """The inference in one line, as it stands among the options of ``dataset.json``."""
        return f"{self.value} ({self.certainty}: {self.evidence})"


class FieldChoice(msgspec.Struct, frozen=True, rename={"canonical": "means", "certainty": "how_surely"}):
    """The field of the release that was chosen for a canonical one."""

    canonical: str
    field: str
    certainty: Certainty
    evidence: str


class Problem(msgspec.Struct, frozen=True, rename={"key": "sequence", "message": "problem"}):
    """One problem of one sequence."""

    key: str
    message: str
    left_out: bool
    """True if the sequence was left out; else it was imported in spite of the problem."""


def grouped(problems: Iterable[Problem]) -> list[tuple[str, int, str]]:
    """Return messages, the number of sequences they concern, and the first of these; the most frequent first."""
    counts: Counter[str] = Counter()
    first: dict[str, str] = {}
    for problem in problems:
        counts[problem.message] += 1
        first.setdefault(problem.message, problem.key)
    return [(message, count, first[message]) for message, count in counts.most_common()]


class _CountRow(msgspec.Struct, frozen=True, rename={"expected": "study"}):
    """Number of sequences of one split, beside the study's."""

    split: str
    found: int
    expected: int | None
    """None where the study states none."""


@dataclass(frozen=True)
class ImportReport:
    """Everything that an import of one dataset inferred, and every problem that it met."""

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
        """Number of sequences that were left out."""
        return len({problem.key for problem in self.problems if problem.left_out})

    def write(self) -> None:
        """Write ``import_report.json`` beside ``dataset.json``; it holds no time of day and no absolute path."""
        write_json(self.folder / FILE_NAME, self.as_json())

    def as_json(self) -> dict[str, Any]:
        """The report as JSON."""
        return {
            "dataset": self.dataset,
            "shape_of_target_information": self.shape,
            "fields": msgspec.to_builtins(self.fields),
            "fields_kept_in_extra": list(self.unmapped),
            "inferred": msgspec.to_builtins(self.inferences),
            "counts": msgspec.to_builtins(self.counts),
            "warnings": list(self.warnings),
            "problems": msgspec.to_builtins(self.problems),
        }

    def problem_lines(self, most: int = 12) -> list[str]:
        """Return one line for each kind of problem, the most frequent first."""
        groups = grouped(self.problems)
        lines = [f"{count} × {message} (first: {key})" for message, count, key in groups[:most]]
        if len(groups) > most:
            lines.append(f"… and {len(groups) - most} more kinds; {FILE_NAME} lists them")
        return lines


def count_rows(splits: Iterable[str], known: KnownDataset | None) -> tuple[_CountRow, ...]:
    """Count the sequences of each split, beside the study's."""
    found = Counter(splits)
    expected = {} if known is None else {"train": known.train, "test": known.test, "validation": 0}
    # A split without sequences is listed where the study has some: a missing split must be seen.
    names = [name for name in ("train", "validation", "test") if found[name] or expected.get(name)]
    return tuple(_CountRow(name, found[name], expected.get(name)) for name in names)


def count_warnings(rows: Iterable[_CountRow]) -> tuple[str, ...]:
    """Return a sentence for each split whose count differs from the study's, as that of a later release may."""
    return tuple(
        f"{row.split}: {row.found} sequences, the study has {row.expected}."
        for row in rows
        if row.expected is not None and row.found != row.expected
    )
