"""Narration files: rows of times and answers, or a clear no (docs/specification/nymeria.md#narrations)."""

from __future__ import annotations

import csv
from pathlib import Path

from prbench.bounded import require_size
from prbench.corpora.nymeria import format as nymeria
from prbench.corpora.nymeria.format import Narration
from prbench.errors import InputFileError

_LONGEST_DURATION = 1000.0  # where every duration is longer, the unit is no second


def read_narrations(path: Path, kind: str) -> tuple[Narration, ...]:
    """Read one narration file, rows in file order.

    Empty answers are kept as empty texts, so that they can be counted; an empty file has no rows.

    Args:
        path: CSV, with or without byte order mark.
        kind: Key of :data:`prbench.corpora.nymeria.format.NARRATION_FILES`.

    Raises:
        InputFileError: if a time column or every answer column is missing, a time is no number, a line is cut, or the
            times are milliseconds.
    """
    try:
        require_size(path)
        with open(path, encoding="utf-8-sig", newline="") as file:
            rows = list(csv.reader(file))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputFileError(path, "", expected="comma-separated text in UTF-8", found=str(error)) from error
    rows = [(number, row) for number, row in enumerate(rows, start=1) if any(cell.strip() for cell in row)]
    if not rows:
        return ()
    header = [name.strip() for name in rows[0][1]]
    start, end, annotator, answers = _columns(path, header)
    narrations = []
    for number, row in rows[1:]:
        if len(row) < len(header):
            raise InputFileError(
                path,
                f"row {number}",
                expected=f"{len(header)} cells",
                found=str(len(row)),
                remedy="The file may be truncated; download it again.",
            )
        texts = tuple((name, row[column].strip()) for name, column in answers)
        times = (_seconds(path, number, row[start]), _seconds(path, number, row[end]))
        narrations.append(Narration(kind, *times, texts, "" if annotator is None else row[annotator].strip()))
    _require_seconds(path, narrations)
    return tuple(narrations)


def _columns(path: Path, header: list[str]) -> tuple[int, int, int | None, list[tuple[str, int]]]:
    """Columns of start, end, annotator and answers; answers by the name that follows "Describe my"."""
    lower = [name.lower() for name in header]
    for name in (nymeria.START_COLUMN, nymeria.END_COLUMN):
        if name not in lower:
            raise _missing(path, f"a column '{name}'", header)
    answers = [
        (header[column][len(nymeria.ANSWER_PREFIX) :].strip(), column)
        for column, name in enumerate(lower)
        if name.startswith(nymeria.ANSWER_PREFIX)
    ]
    if not answers:
        raise _missing(path, "a column whose name begins with 'Describe my'", header)
    annotator = lower.index(nymeria.ANNOTATOR_COLUMN) if nymeria.ANNOTATOR_COLUMN in lower else None
    return lower.index(nymeria.START_COLUMN), lower.index(nymeria.END_COLUMN), annotator, answers


def _missing(path: Path, expected: str, header: list[str]) -> InputFileError:
    return InputFileError(
        path,
        "header",
        expected=expected,
        found=f"the columns {', '.join(header)}",
        remedy="This is another file, or another version of the format.",
    )


def _seconds(path: Path, number: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise InputFileError(
            path, f"row {number}", expected="a time in seconds", found=f"'{cell}'", remedy="Download the file again."
        )
    return value


def _require_seconds(path: Path, narrations: list[Narration]) -> None:
    durations = [row.end - row.start for row in narrations]
    if durations and min(durations) > _LONGEST_DURATION:
        raise InputFileError(
            path,
            "start_time, end_time",
            expected="seconds",
            found=f"{min(durations):,.0f} or more from start to end in every row",
            remedy="These look like milliseconds; divide both columns by 1,000.",
        )
