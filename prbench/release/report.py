"""The report of an import and of an export, as commands print it and as ``import_report.json`` holds it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import msgspec

if TYPE_CHECKING:  # help is quick: tables load NumPy
    from prbench.tables import Table

FILE_NAME = "import_report.json"
# Words for: stated and confirmed; measured with room for doubt; taken for granted; not found out.
Certainty = Literal["certain", "likely", "assumed", "unknown"]


class Inference(msgspec.Struct, frozen=True, kw_only=True):
    """One property that the release does not state.

    Attributes:
        name: What was inferred.
        value: What it was taken to be.
        how_surely: ``certain`` (stated and confirmed), ``likely`` (measured), ``assumed`` or ``unknown``.
        evidence: What speaks for it.
    """

    name: str
    value: str
    how_surely: Certainty
    evidence: str


class SequenceProblem(msgspec.Struct, frozen=True):
    """One problem of one sequence.

    Attributes:
        sequence: Its key in the release.
        problem: What is wrong.
        left_out: Whether the sequence was left out; else it was imported in spite of the problem.
    """

    sequence: str
    problem: str
    left_out: bool


class ImportReport(msgspec.Struct, kw_only=True):
    """One dataset of the release that becomes a table; the same stands in its ``import_report.json``.

    Attributes:
        dataset: Name of the dataset.
        title: Its title.
        folder: The table; the file leaves it out.
        inferred: What the release does not state.
        fields: Maps what is needed to the field of the release that holds it.
        fields_kept_in_extra: Fields of the release of which nothing is known; the column ``extra`` keeps them.
        warnings: What a user should look at.
        problems: Problems of single sequences.
        why_not_scored: Why metrics will be refused on this table; null where they will not.
    """

    dataset: str
    title: str = ""
    folder: Path
    inferred: list[Inference] = []
    fields: dict[str, str] = {}
    fields_kept_in_extra: list[str] = []
    warnings: list[str] = []
    problems: list[SequenceProblem] = []
    why_not_scored: str | None = None

    def infer(self, name: str, value: str, how_surely: Certainty, evidence: str) -> None:
        """Put down a property that the release does not state."""
        self.inferred.append(Inference(name=name, value=value, how_surely=how_surely, evidence=evidence))

    def note(self, key: str, problem: str, *, left_out: bool = False) -> None:
        """Note a problem of a sequence."""
        self.problems.append(SequenceProblem(key, problem, left_out))

    @property
    def reasons(self) -> dict[str, str]:
        """Maps every sequence that was left out to all its problems."""
        found: dict[str, list[str]] = {}
        for problem in self.problems:
            if problem.left_out:
                found.setdefault(problem.sequence, []).append(problem.problem)
        return {key: "; ".join(texts) for key, texts in found.items()}

    @property
    def left_out(self) -> int:
        """Number of sequences that were left out."""
        return len(self.reasons)

    def write(self) -> None:
        """Write ``import_report.json`` beside ``dataset.json``; it holds no time of day and no absolute path."""
        from prbench.files.storage import write_json  # not with the module: the command line reads only its shapes

        content = {name: value for name, value in msgspec.structs.asdict(self).items() if name != "folder"}
        write_json(self.folder / FILE_NAME, msgspec.to_builtins(content))

    def problem_lines(self, most: int = 12) -> list[str]:
        """Return one line for each kind of problem, the most frequent first."""
        first: dict[str, str] = {}
        for each in self.problems:
            first.setdefault(each.problem, each.sequence)
        counts = Counter(each.problem for each in self.problems).most_common()
        lines = [f"{count} × {problem} (first: {first[problem]})" for problem, count in counts[:most]]
        if len(counts) > most:
            lines.append(f"… and {len(counts) - most} more kinds; {FILE_NAME} lists them")
        return lines


class ImportReleaseReport(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an import.

    Attributes:
        tables: One entry for each table that was written.
        failed: Maps datasets that could not be imported to the reason.
        sizes: Tables 1 and S2 of the study: what was imported beside what the study prints.
    """

    tables: list[ImportReport]
    failed: dict[str, str]
    sizes: list[Table] = []

    @property
    def complete(self) -> bool:
        """True if nothing had to be left out."""
        return not self.failed and not any(table.left_out for table in self.tables)


class ExportedTable(msgspec.Struct, frozen=True, kw_only=True):
    """One table that was written in the layout of the release.

    Attributes:
        dataset: Name of the dataset.
        folder: Its folder in the release.
        sequences: Number of sequences.
        notice: Terms under which the folder may be passed on; empty if there are none.
    """

    dataset: str
    folder: Path
    sequences: int
    notice: str


class ExportReleaseReport(msgspec.Struct, frozen=True, kw_only=True):
    """The result of an export.

    Attributes:
        datasets: One entry for each table.
    """

    datasets: list[ExportedTable]
