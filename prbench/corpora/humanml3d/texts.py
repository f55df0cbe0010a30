"""Text files: one caption a line, with tokens and the part of the motion that it describes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from prbench.bounded import read_text
from prbench.corpora.humanml3d.format import TEXT_SEPARATOR
from prbench.errors import InputFileError
from prbench.limits import HARMLESS_SIZE


@dataclass(frozen=True)
class TextLine:
    """One caption."""

    text: str
    tokens: str
    """``word/POS`` separated by spaces."""
    start: float
    """Seconds; 0 with ``end`` 0 means the whole motion."""
    end: float

    @property
    def is_whole(self) -> bool:
        """Whether the caption describes the whole motion."""
        return self.start == 0.0 and self.end == 0.0


def read_texts(path: Path) -> tuple[TextLine, ...]:
    """Read one text file. A time that is NaN counts as 0, as in the official loader; empty lines are passed over.

    Raises:
        InputFileError: if the file is missing, a line lacks a part, or a time is no number.
    """
    try:
        content = read_text(path, largest=HARMLESS_SIZE)
    except FileNotFoundError as error:
        raise InputFileError(
            path, "", expected="this file", found="no such file", remedy="Unpack texts.zip."
        ) from error
    except UnicodeDecodeError as error:
        raise InputFileError(path, "", expected="text in UTF-8", found="other bytes") from error
    lines = enumerate(content.splitlines(), start=1)
    return tuple(_parse(path, number, line) for number, line in lines if line.strip())


def _parse(path: Path, number: int, line: str) -> TextLine:
    parts = line.strip().rsplit(TEXT_SEPARATOR, 3)
    if len(parts) != 4:
        raise InputFileError(
            path,
            f"line {number}",
            expected="caption#tokens#from#to",
            found=f"'{line[:80]}'",
            remedy="The file may be cut; unpack texts.zip again.",
        )
    text, tokens, *times = (part.strip() for part in parts)
    start, end = (_seconds(path, number, cell) for cell in times)
    return TextLine(text, tokens, start, end)


def _seconds(path: Path, number: int, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError as error:
        raise InputFileError(path, f"line {number}", expected="a time in seconds", found=f"'{cell}'") from error
    if math.isinf(value):
        raise InputFileError(path, f"line {number}", expected="a finite time in seconds", found=cell)
    return 0.0 if math.isnan(value) else value
