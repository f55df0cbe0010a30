"""``dataset.csv``: the segments of GIMO (docs/specification/gimo.md#segment-table)."""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from prbench.errors import InputFileError
from prbench.files.bounded import require_size
from prbench.readers.files import missing_file
from prbench.readers.gimo import format as gimo

_LAST_FRAME = 10**7
"""Frame number that no recording reaches: four days at 30 frames a second."""
_SPLITS = (gimo.TEST, gimo.TRAIN, gimo.TRAIN_LATER)


@dataclass(frozen=True)
class Row:
    """A segment, and what its line in the file brought up."""

    line: int
    segment: gimo.Segment
    repeated: tuple[int, ...] = ()
    """Further lines that say exactly the same; they are left out."""

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return remarks for the report of a build."""
        if not self.repeated:
            return ()
        lines = ", ".join(str(line) for line in self.repeated)
        return (f"line {self.line} of {gimo.TABLE_FILE} is repeated in line {lines}; the repetition is left out",)


def read_segments(path: Path) -> tuple[Row, ...]:
    """All segments in the order of the file, each once.

    The byte-order mark, further columns and unnamed ones are welcome; the eighth column, where it is unnamed, holds
    hints. A hint that is no frame of its segment is no hint.

    Raises:
        InputFileError: naming the line: for a missing column, a value that is no frame number, a segment that ends
            before it starts, another value of ``training`` than 0, 1 or 2, or one segment listed twice with
            different splits or transformations.
    """
    header, lines = _read(path)
    rows: dict[tuple[str, str, int, int], Row] = {}
    for line, cells in lines:
        segment = _segment(path, line, header, cells)
        first = rows.get(segment.key)
        if first is None:
            rows[segment.key] = Row(line, segment)
        elif (first.segment.training, first.segment.transformation) == (segment.training, segment.transformation):
            rows[segment.key] = Row(first.line, first.segment, (*first.repeated, line))
        else:
            raise InputFileError(
                path,
                f"line {line}",
                expected=f"the same split and transformation as line {first.line}, which is the same segment",
                found=f"training {segment.training}, {segment.transformation}",
                remedy="Remove one of the two lines.",
            )
    if not rows:
        raise InputFileError(path, "", expected="segments, one a line", found="a header alone")
    return tuple(rows.values())


def overlapping(rows: tuple[Row, ...], row: Row) -> tuple[gimo.Segment, ...]:
    """Other segments of the same sequence that share frames with one."""
    mine = row.segment
    return tuple(
        other.segment
        for other in rows
        if other.segment.key != mine.key
        and (other.segment.scene, other.segment.sequence) == (mine.scene, mine.sequence)
        and other.segment.start_frame <= mine.end_frame
        and other.segment.end_frame >= mine.start_frame
    )


def read_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV file that hold anything, with their numbers.

    Raises:
        InputFileError: if the file is missing or no text.
    """
    try:
        require_size(path)
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            for cells in reader:
                if any(cell.strip() for cell in cells):
                    yield reader.line_num, [cell.strip() for cell in cells]
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputFileError(path, "", expected="text with comma-separated values", found=str(error)) from error


def _read(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    lines = list(read_lines(path))
    if not lines:
        raise InputFileError(path, "", expected="a header and segments", found="nothing")
    header = lines[0][1]
    missing = [name for name in gimo.TABLE_COLUMNS if name not in header]
    if missing:
        raise InputFileError(
            path,
            "header",
            expected=f"a column '{missing[0]}'",
            found=f"the columns {', '.join(cell or '(unnamed)' for cell in header)}",
            remedy="This is another file, or another version of the table.",
        )
    return header, lines[1:]


def _segment(path: Path, line: int, header: list[str], cells: list[str]) -> gimo.Segment:
    # Of two columns of one name the first counts, so the cells are looked up from the last to the first.
    values = dict(reversed(list(itertools.zip_longest(header, cells[: len(header)], fillvalue=""))))
    start, end, training = (
        _number(path, line, name, values[name]) for name in ("start_frame", "end_frame", "training")
    )
    for name in ("scene", "sequence_path", "transformation"):
        if not values[name]:
            raise InputFileError(path, f"line {line}", expected=f"a '{name}'", found="nothing")
    if start > end:
        raise InputFileError(
            path,
            f"line {line}",
            expected="a start_frame that is not behind the end_frame",
            found=f"{start} to {end}",
            remedy="Correct the line, or remove it.",
        )
    if training not in _SPLITS:
        raise InputFileError(
            path,
            f"line {line}",
            expected="training 1 (train), 0 (test) or 2 (train, but unused by the official loader)",
            found=str(training),
            remedy="Correct the line, or remove it.",
        )
    return gimo.Segment(
        scene=values["scene"],
        sequence=values["sequence_path"],
        start_frame=start,
        end_frame=end,
        transformation=values["transformation"],
        training=training,
        activity=values.get(gimo.ACTIVITY_COLUMN, ""),
        hint=_hint(header, cells, start, end),
    )


def _number(path: Path, line: int, name: str, text: str) -> int:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not (0 <= value <= _LAST_FRAME and value.is_integer()):
        raise InputFileError(path, f"line {line}", expected=f"a whole number '{name}'", found=f"'{text}'")
    return int(value)


def _hint(header: list[str], cells: list[str], start: int, end: int) -> int | None:
    """The frame in the unnamed eighth column, if it is one of the segment."""
    named = len(header) > gimo.HINT_INDEX and header[gimo.HINT_INDEX] not in ("", f"Unnamed: {gimo.HINT_INDEX}")
    if named or len(cells) <= gimo.HINT_INDEX:
        return None
    try:
        frame = float(cells[gimo.HINT_INDEX])
    except ValueError:
        return None
    return int(frame) if frame.is_integer() and start <= frame <= end else None
