"""Lines of a CSV text found by time, without reading the lines between them.

The time column increases from line to line; beyond that nothing is assumed: neither equal steps nor equal lengths. A
place is guessed by proportion, checked by the times of the two lines that meet there, and corrected until the wanted
time lies between two neighbouring lines. All wanted times are searched for together.
"""

from __future__ import annotations

import io
import mmap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path
from typing import cast

import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Bool, Int, UInt8
from numpy.lib.stride_tricks import sliding_window_view

from prbench.files.bounded import open_regular
from prbench.readers.aria_mps.format import POSE_RATE, grid_times_us, rows_around, wanted_times_us
from prbench.readers.files import (
    Column,
    RememberingTail,
    Source,
    arrow_types,
    header_names,
    missing_file,
    opened,
    require_column_names,
    require_integers,
    require_whole_last_line,
    shown,
)

NEWLINE = b"\n"[0]
_COMMA = b","[0]
QUOTE = b'"'[0]
_ANCHOR_STEP = 2**16  # bytes between the lines whose times are looked at first
_PROPORTIONAL_TURNS = 4  # then the middle is guessed, which always ends
_MOST_TURNS = 64
_MOST_DIGITS = 18  # of a time that an int64 can hold


class NotSearchable(Exception):
    """The text is none that can be searched: read it whole, which works or tells what is wrong."""


@dataclass(frozen=True)
class Block:
    """Whole lines of a text: the bytes of ``content`` from ``begin`` to before ``stop``.

    The last line may lack its line break.
    """

    content: bytearray | mmap.mmap
    begin: int
    stop: int


@dataclass(frozen=True)
class Lines:
    """Some neighbouring pairs of lines, sorted; of a wanted time before the first line both are the first line."""

    first: Int[np.ndarray, " n"]
    """Offsets at which the first line of each pair begins."""
    second: Int[np.ndarray, " n"]


@dataclass(frozen=True)
class TimedLines:
    """Lines of a CSV text with an integer column that increases. A line is known by the place where it begins."""

    block: Block
    column: int
    """Number of the time column, from 0."""
    time_ends: int
    """Bytes of a line in which the time column ends, at most."""

    @cached_property
    def last(self) -> int:
        """The last line."""
        return int(self._before(np.array([self.block.stop]))[0])

    def times(self, lines: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """The times of some lines.

        Raises:
            NotSearchable: if one is no plain number.
        """
        width = min(self.time_ends, len(self._bytes))
        fitting = np.minimum(lines - self.block.begin, len(self._bytes) - width)  # at the end windows begin earlier
        window = sliding_window_view(self._bytes, width)[fitting]
        return _integers(window, *_cell_bounds(window, lines - self.block.begin - fitting, self.column))

    def around(self, wanted: Int[np.ndarray, " n"]) -> Lines:
        """The lines on both sides of every wanted time: the last before it, the first at or after it.

        Args:
            wanted: Sorted; none later than the last line. Of a time before the first line only that line counts.

        Raises:
            NotSearchable: if times do not increase as far as they were looked at, or are no plain numbers.
        """
        # Lines spread over the text bracket every wanted time, so that the search begins close to it.
        anchors = self._anchors()
        anchor_times = self.times(anchors)
        if (np.diff(anchor_times) <= 0).any():
            raise NotSearchable("times do not increase")
        above = np.searchsorted(anchor_times, wanted)
        if above.size and above[-1] == len(anchors):
            raise NotSearchable("a time after the last line is wanted")
        first, second = (np.full(len(wanted), self.block.begin) for _ in range(2))
        inner = above > 0
        above = above[inner]
        bounds = anchors[above - 1], anchor_times[above - 1], anchors[above], anchor_times[above]
        first[inner], second[inner] = self._close_in(wanted[inner], *bounds)
        return Lines(first, second)

    def copied(self, lines: Lines) -> bytes:
        """The text of some lines, each once; neighbours are copied together."""
        if len(lines.first) == 0:
            return b""
        apart = lines.first[1:] > lines.second[:-1]
        begins = lines.first[np.append(True, apart)]
        stops = self._at_or_after(lines.second[np.append(apart, True)] + 1)
        view = memoryview(self.block.content)
        return b"".join([view[begin:stop] for begin, stop in zip(begins.tolist(), stops.tolist(), strict=True)])

    @cached_property
    def _bytes(self) -> UInt8[np.ndarray, " size"]:
        return np.frombuffer(self.block.content, np.uint8, self.block.stop - self.block.begin, self.block.begin)

    def _at_or_after(self, places: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """The first line that begins at or after each place, which lies behind the beginning of the first line."""
        breaks = map(self.block.content.find, repeat(b"\n"), (places - 1).tolist(), repeat(self.block.stop))
        found = np.fromiter(breaks, np.int64, len(places)) + 1
        return np.where(found == 0, self.block.stop, found)

    def _before(self, lines: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """The line before each line, or before the end; none is the first."""
        begin = self.block.begin
        breaks = map(self.block.content.rfind, repeat(b"\n"), repeat(begin), (lines - 1).tolist())
        return np.maximum(np.fromiter(breaks, np.int64, len(lines)) + 1, begin)

    def _anchors(self) -> Int[np.ndarray, " k"]:
        """Some lines, the first and the last among them."""
        between = self._at_or_after(np.arange(self.block.begin + _ANCHOR_STEP, self.last, _ANCHOR_STEP))
        return np.unique(np.concatenate([[self.block.begin], between, [self.last]]))

    def _close_in(
        self,
        wanted: Int[np.ndarray, " n"],
        low: Int[np.ndarray, " n"],
        low_time: Int[np.ndarray, " n"],
        high: Int[np.ndarray, " n"],
        high_time: Int[np.ndarray, " n"],
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Neighbouring lines around each wanted time, from a line before it and a line at or after it."""
        first = np.empty_like(low)
        second = np.empty_like(low)
        open_ = np.arange(len(low))
        for turn in range(_MOST_TURNS):
            if open_.size == 0:
                return first, second
            share = (wanted - low_time) / (high_time - low_time) if turn < _PROPORTIONAL_TURNS else 0.5
            guess = low + np.ceil(share * (high - low)).astype(np.int64)
            middle = self._at_or_after(np.clip(guess, low + 1, high))
            beyond = middle >= high
            middle[beyond] = self._before(high[beyond])
            middle_time = self.times(middle)
            early = middle_time < wanted
            beside = np.empty_like(middle)
            beside[early] = self._at_or_after(middle[early] + 1)
            beside[~early] = self._before(middle[~early])
            beside_time = self.times(beside)
            if ((beside_time > middle_time) != early).any():
                raise NotSearchable("times do not increase")
            done = early == (beside_time >= wanted)
            first[open_[done]] = np.where(early, middle, beside)[done]
            second[open_[done]] = np.where(early, beside, middle)[done]
            # Of the others both lines lie on one side of the wanted time; the nearer one is the new bound.
            low = np.where(early, beside, low)
            low_time = np.where(early, beside_time, low_time)
            high = np.where(early, high, beside)
            high_time = np.where(early, high_time, beside_time)
            wanted, low, low_time, high, high_time, open_ = (
                values[~done] for values in (wanted, low, low_time, high, high_time, open_)
            )
        raise NotSearchable("the search does not end")


def _cell_bounds(
    window: UInt8[np.ndarray, "n width"], skipped: Int[np.ndarray, " n"], column: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """First place of one cell of each line, and the place after its last.

    Args:
        window: The beginnings of lines.
        skipped: Where in its window each line begins.
        column: Which cell, from 0.
    """
    n, width = window.shape
    if n == 0:
        return skipped, skipped
    separators = np.flatnonzero((window == _COMMA) | (window == NEWLINE))
    own = np.arange(n) * width
    number = np.searchsorted(separators, own + skipped) + column  # of the separator that ends the cell
    if number[-1] >= len(separators) or (separators[number] >= own + width).any():
        raise NotSearchable("a line lacks the time column")
    first = separators[number - 1] + 1 - own if column else skipped
    return first, separators[number] - own


def _integers(
    window: UInt8[np.ndarray, "n width"], first: Int[np.ndarray, " n"], last: Int[np.ndarray, " n"]
) -> Int[np.ndarray, " n"]:
    """Plain decimal numbers in the places from ``first`` to before ``last``."""
    if len(first) == 0:
        return np.zeros(0, dtype=np.int64)
    length = last - first
    if length.min() < 1 or length.max() > _MOST_DIGITS:
        raise NotSearchable("a time is no number")
    # In most files all times have one length and one place: one slice instead of an index for every digit.
    alike = (first == first[0]).all() and (length == length[0]).all()
    if alike:
        digits = window[:, first[0] : last[0]] - ord("0")
        inside: Bool[np.ndarray, "#n digits"] = np.ones((1, digits.shape[1]), dtype=bool)
    else:
        places = last[:, None] - np.arange(int(length.max()), 0, -1)
        inside = places >= first[:, None]
        digits = np.take_along_axis(window, np.maximum(places, 0), axis=1) - ord("0")
    # Bytes are unsigned: what stands before "0" wraps round to a large number and is found here, too.
    if ((digits > 9) & inside).any():
        raise NotSearchable("a time is no number")
    return np.where(inside, digits, 0).astype(np.int64) @ 10 ** np.arange(digits.shape[1] - 1, -1, -1)


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
        # Header and first line (see :func:`prbench.readers.files.opened` for what it raises).
        with opened(source) as file:
            start = _TextStart(file.readline(_LONGEST_LINE), file.readline(_LONGEST_LINE))
        if QUOTE in start.header + start.first_line or len(start.first_line) == _LONGEST_LINE:
            raise NotSearchable("quoted or very long lines")
    except FileNotFoundError as error:
        raise missing_file(source) from error
    except UnicodeDecodeError as error:
        raise NotSearchable("no text") from error
    require_column_names(source, start.names, columns)
    # The lines around the wanted times, one after the other, with their line breaks.
    column = start.names.index(time_column)
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
    text = b"".join(pieces)
    require_whole_last_line(shown(source), columns, start.names, tail=text[-RememberingTail.LENGTH :])
    table = pyarrow.csv.read_csv(
        pa.BufferReader(start.header + text),
        read_options=pyarrow.csv.ReadOptions(use_threads=False),  # workers share the cores among them
        convert_options=pyarrow.csv.ConvertOptions(column_types=arrow_types(columns), include_columns=list(columns)),
    )
    require_integers(source, table, columns)
    return table


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
