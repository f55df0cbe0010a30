"""First and last times in a file, found out from its ends alone.

Only plain files are looked at in this way. What lies in an archive has to be unpacked to see its end, so large members
are left to whoever reads the recording. Lines that make no sense are passed over: reading says what is wrong with them.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

import numpy as np

from prbench.bounded import open_regular
from prbench.limits import LARGEST_UNPACKED_FOR_ITS_END
from prbench.readers.extents import Extent
from prbench.readers.files import header_names
from prbench.readers.found import InputFile
from prbench.readers.zipped import opened, source_of

_END = 1 << 18
"""Bytes that are read of each end. The static objects of an ADT recording take 60 kB before the first one that moves;
a frame of a skeleton, printed with one number a line, 130 kB."""
_NAMED_TIME = re.compile(rb'"(?:tracking_)?timestamp_ns"\s*:\s*(\d{1,19})(?=[\s,}])')

Span = tuple[float | None, float | None]
"""First and last time, seconds; None where an end holds none."""


def can_be_looked_at(file: InputFile) -> bool:
    """Whether the ends of a file can be seen without much work."""
    return not file.member or file.size <= LARGEST_UNPACKED_FOR_ITS_END


def csv_extent(stream: str, file: InputFile, column: str, seconds: float) -> Extent:
    """The extent of a CSV file.

    Args:
        stream: What it holds.
        file: The file.
        column: Name of its time column; negative times are none.
        seconds: Length of the column's unit.
    """
    head, tail = _both_ends(file)
    header, _, rows = head.partition(b"\n")
    first = None
    last = None
    place = _place(header, column)
    if place is not None:
        first = min(_cells(rows.splitlines()[:-1] if len(head) == _END else rows.splitlines(), place), default=None)
        last = max(_cells(tail.splitlines()[1:], place), default=None)
    return Extent(stream, _name(file), *_scaled(first, last, seconds))


def json_extent(stream: str, file: InputFile) -> Extent:
    """The extent of a JSON or JSON lines file whose frames have a ``timestamp_ns``."""
    head, tail = _both_ends(file)
    first = min((float(time) for time in _NAMED_TIME.findall(head)), default=None)
    last = max((float(time) for time in _NAMED_TIME.findall(tail)), default=None)
    return Extent(stream, _name(file), *_scaled(first, last, 1e-9))


def _both_ends(file: InputFile) -> tuple[bytes, bytes]:
    """The first and the last bytes; of a small file or a member of an archive all of it where that is less."""
    if not file.member:
        with open_regular(file.path) as plain:
            head = plain.read(_END)
            plain.seek(max(os.fstat(plain.fileno()).st_size - _END, 0))
            return head, plain.read()
    with opened(source_of(file)) as member:
        content = member.read(LARGEST_UNPACKED_FOR_ITS_END)
    return content[:_END], content[-_END:]


def _cells(lines: Iterable[bytes], place: int) -> Iterable[float]:
    """The numbers of one column that can be times."""
    for line in lines:
        values = line.split(b",", place + 1)
        try:
            time = float(values[place])
        except (IndexError, ValueError):
            continue
        if np.isfinite(time) and time >= 0:
            yield time


def _scaled(first: float | None, last: float | None, seconds: float) -> Span:
    return (None if first is None else first * seconds), (None if last is None else last * seconds)


def _place(header: bytes, column: str) -> int | None:
    """Which column it is; None where the file has none of that name."""
    try:
        names = header_names(header)
    except UnicodeDecodeError:
        return None
    return names.index(column) if column in names else None


def _name(file: InputFile) -> str:
    return file.member.rpartition("/")[2] or file.path.name
