"""Read only the rows around wanted times of a long CSV file: found by searching, parsed together."""

from __future__ import annotations

import io
import mmap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Int

from prbench.files.bounded import open_regular
from prbench.readers.aria_mps.format import POSE_RATE, grid_times_us, rows_around, wanted_times_us
from prbench.readers.aria_mps.line_search import NEWLINE, QUOTE, Block, Lines, NotSearchable, TimedLines
from prbench.readers.files import (
    Column,
    arrow_types,
    header_names,
    missing_file,
    require_column_names,
    require_integers,
)
from prbench.readers.zipped import RememberingTail, Source, opened, require_whole_last_line, shown


@dataclass(frozen=True)
class NearGaze:
    """Rows around gaze times and a regular grid, first and last row included (``wanted_times_us``)."""

    gaze_us: Int[np.ndarray, " n"]
    """Increasing."""
    rate: float = POSE_RATE

    def between(self, first_us: int, after_us: int | None, until_us: int) -> Int[np.ndarray, " n"]:
        """Sorted wanted times after one time (None: from the beginning) until another one.

        Args:
            first_us: Time of the first row.
            after_us: Later than this.
            until_us: Not later than this.
        """
        after = first_us - 1 if after_us is None else after_us
        gaze = self.gaze_us[slice(*np.searchsorted(self.gaze_us, (after, until_us), side="right"))]
        times = np.union1d(gaze, grid_times_us(first_us, max(after, first_us), until_us, self.rate))
        return times[(times > after) & (times <= until_us)]

    def beyond(self, last_us: int) -> bool:  # noqa: ARG002
        """True where a time after that of the last row is wanted: the last row then counts."""
        return True

    def rows(self, time_us: Int[np.ndarray, " n"]) -> Int[np.ndarray, " k"]:
        """The same choice among rows whose times are all known."""
        return rows_around(time_us, wanted_times_us(self.gaze_us, int(time_us[0]), int(time_us[-1]), self.rate))

    def key(self) -> bytes:
        """Equal for equal wishes."""
        return f"gaze {self.rate} ".encode() + self.gaze_us.tobytes()


_BLOCK = 8 * 2**20
"""Bytes of text in memory at once."""
_LONGEST_LINE = 2**16
_BREAKS = (NEWLINE, b"\r"[0])


@dataclass(frozen=True)
class _TextStart:
    """The beginning of a CSV file."""

    header: bytes
    """With its line break."""
    first_line: bytes
    """First line of the data; empty where there is none."""

    @property
    def names(self) -> list[str]:
        """The columns."""
        return header_names(self.header)


def search_rows(
    source: Source, columns: Mapping[str, Column], time_column: str, wanted: NearGaze, *, block: int = _BLOCK
) -> pa.Table:
    """The rows around wanted times, equal to those of a whole read to the last bit.

    What lies between these rows is never looked at: neither a repeated row nor a damaged number there is noticed. In
    an archive every byte is unpacked, and its checksum compared.

    Args:
        source: CSV, plain or in an archive.
        columns: Name and type of each column to parse.
        time_column: The one of them that increases; integers.
        wanted: Which rows.
        block: Bytes of text in memory at once, about.

    Raises:
        NotSearchable: if the text is unusual or its times do not increase, as far as they were looked at.
        pa.ArrowInvalid: if a found row does not parse.
        InputFileError: if the file or a column is missing, the last line is cut, or an archive is damaged.
    """
    try:
        start = _read_start(source)
    except FileNotFoundError as error:
        raise missing_file(source) from error
    except UnicodeDecodeError as error:
        raise NotSearchable("no text") from error
    require_column_names(source, start.names, columns)
    text = _found_text(source, start, start.names.index(time_column), wanted, block)
    require_whole_last_line(shown(source), columns, start.names, tail=text[-RememberingTail.LENGTH :])
    table = pyarrow.csv.read_csv(
        pa.BufferReader(start.header + text),
        read_options=pyarrow.csv.ReadOptions(use_threads=False),  # workers share the cores among them
        convert_options=pyarrow.csv.ConvertOptions(column_types=arrow_types(columns), include_columns=list(columns)),
    )
    require_integers(source, table, columns)
    return table


def _read_start(source: Source) -> _TextStart:
    """Header and first line (see :func:`prbench.readers.zipped.opened` for what it raises).

    Raises:
        NotSearchable: if these are no plain short lines.
    """
    with opened(source) as file:
        start = _TextStart(file.readline(_LONGEST_LINE), file.readline(_LONGEST_LINE))
    if QUOTE in start.header + start.first_line or len(start.first_line) == _LONGEST_LINE:
        raise NotSearchable("quoted or very long lines")
    return start


def _found_text(source: Source, start: _TextStart, column: int, wanted: NearGaze, block: int) -> bytes:
    """The lines around the wanted times, one after the other, with their line breaks."""
    first_us = after_us = None
    pieces = []
    last_line = b""
    last_is_taken = False
    for text in _line_blocks(source, len(start.header), block):
        lines = TimedLines(text, column, _time_ends(start.first_line, column))
        begin_us, end_us = lines.times(np.array([text.begin, lines.last])).tolist()
        first_us = begin_us if first_us is None else first_us
        pairs = lines.around(wanted.between(first_us, after_us, end_us))
        if last_is_taken:  # it is the first one here
            pairs = Lines(np.where(pairs.first == text.begin, pairs.second, pairs.first), pairs.second)
        pieces.append(lines.copied(pairs))
        last_is_taken = bool((pairs.second == lines.last).any()) or (last_is_taken and lines.last == text.begin)
        only_last = np.array([lines.last])
        after_us = end_us
        last_line = lines.copied(Lines(only_last, only_last))
    if after_us is not None and not last_is_taken and wanted.beyond(after_us):
        pieces.append(last_line)
    return b"".join(pieces)


def _line_blocks(source: Source, first: int, size: int = _BLOCK) -> Iterator[Block]:
    """The lines of a file in blocks; every block but the first begins with the last line of the one before it.

    A block is valid until the next one is asked for. Empty lines at the end of the file are left out.

    Args:
        source: The file.
        first: Where its first line begins.
        size: Bytes of a block, about.

    Raises:
        InputFileError: if an archive is damaged.
        NotSearchable: if lines are very long.
    """
    if isinstance(source, Path):
        yield from _mapped_blocks(source, first, size)
    else:
        yield from _unpacked_blocks(source, first, size)


def _mapped_blocks(path: Path, first: int, size: int) -> Iterator[Block]:
    """Blocks of a plain file: only the pages that are looked at are read, and they are given back after each block."""
    with open_regular(path) as file:
        mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)  # closed with the last block that refers to it
    end = _end_of_content(mapped, len(mapped))
    begin = first
    while begin < end:
        stop = min(begin + size, end)
        if stop < end:
            stop = mapped.rfind(b"\n", begin, stop) + 1
        if stop == 0:
            raise NotSearchable("very long lines")
        yield Block(mapped, begin, stop)
        if stop == end:
            return
        done = begin
        begin = mapped.rfind(b"\n", begin, stop - 1) + 1
        if begin <= done:
            raise NotSearchable("very long lines")
        _give_back(mapped, done, begin)


def _end_of_content(text: bytearray | mmap.mmap, end: int) -> int:
    """Return where the empty lines before ``end`` begin: behind the break of the last line that holds something."""
    while end > 1 and text[end - 1] in _BREAKS and text[end - 2] in _BREAKS:
        end -= 1
    return end


def _give_back(mapped: mmap.mmap, begin: int, stop: int) -> None:
    begin, stop = (place // mmap.PAGESIZE * mmap.PAGESIZE for place in (begin, stop))
    if hasattr(mapped, "madvise") and stop > begin:
        mapped.madvise(mmap.MADV_DONTNEED, begin, stop - begin)


def _unpacked_blocks(source: Source, first: int, size: int) -> Iterator[Block]:
    buffer = bytearray(size + _LONGEST_LINE)
    filled = 0
    with opened(source) as file:
        file.read(first)
        while new := cast(io.BufferedIOBase, file).readinto(memoryview(buffer)[filled : filled + size]):
            filled += new
            stop = _end_of_content(buffer, buffer.rfind(b"\n", 0, filled) + 1)
            if stop:
                yield Block(buffer, 0, stop)
            kept = buffer.rfind(b"\n", 0, max(stop - 1, 0)) + 1
            if filled - kept > _LONGEST_LINE:
                raise NotSearchable("very long lines")
            # The last line moves to the front: it is the first of the next block.
            buffer[: filled - kept] = buffer[kept:filled]
            filled -= kept
    if end := _end_of_content(buffer, filled):
        yield Block(buffer, 0, end)


def _time_ends(first_line: bytes, column: int) -> int:
    """Bytes of a line in which its time column ends, with room for longer cells."""
    return sum(len(cell) + 1 for cell in first_line.split(b",")[: column + 1]) + 24
