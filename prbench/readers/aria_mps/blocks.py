"""A CSV file in blocks of whole lines, plain or unpacked as it is read: memory stays flat however long it is."""

from __future__ import annotations

import io
import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from prbench.bounded import open_regular
from prbench.readers.aria_mps.line_search import NEWLINE, QUOTE, Block, NotSearchable
from prbench.readers.files import header_names
from prbench.readers.zipped import Source, opened

BLOCK = 8 * 2**20
"""Bytes of text in memory at once."""
_LONGEST_LINE = 2**16
_BREAKS = (NEWLINE, b"\r"[0])


@dataclass(frozen=True)
class TextStart:
    """The beginning of a CSV file."""

    header: bytes
    """With its line break."""
    first_line: bytes
    """Of the data; empty where there is none."""

    @property
    def names(self) -> list[str]:
        """The columns."""
        return header_names(self.header)


def read_start(source: Source) -> TextStart:
    """Header and first line (see :func:`prbench.readers.zipped.opened` for what it raises).

    Raises:
        NotSearchable: if these are no plain short lines.
    """
    with opened(source) as file:
        start = TextStart(file.readline(_LONGEST_LINE), file.readline(_LONGEST_LINE))
    if QUOTE in start.header + start.first_line or len(start.first_line) == _LONGEST_LINE:
        raise NotSearchable("quoted or very long lines")
    return start


def line_blocks(source: Source, first: int, size: int = BLOCK) -> Iterator[Block]:
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
    end, begin = _end_of_content(mapped, len(mapped)), first
    while begin < end:
        stop = min(begin + size, end)
        if stop < end:
            stop = mapped.rfind(b"\n", begin, stop) + 1
        if stop == 0:
            raise NotSearchable("very long lines")
        yield Block(mapped, begin, stop)
        if stop == end:
            return
        done, begin = begin, mapped.rfind(b"\n", begin, stop - 1) + 1
        if begin <= done:
            raise NotSearchable("very long lines")
        _give_back(mapped, done, begin)


def _give_back(mapped: mmap.mmap, begin: int, stop: int) -> None:
    begin, stop = (place // mmap.PAGESIZE * mmap.PAGESIZE for place in (begin, stop))
    if hasattr(mapped, "madvise") and stop > begin:
        mapped.madvise(mmap.MADV_DONTNEED, begin, stop - begin)


def _unpacked_blocks(source: Source, first: int, size: int) -> Iterator[Block]:
    buffer, filled = bytearray(size + _LONGEST_LINE), 0
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
            buffer[: filled - kept] = buffer[kept:filled]
            filled -= kept
    if end := _end_of_content(buffer, filled):
        yield Block(buffer, 0, end)


def _end_of_content(text: bytearray | mmap.mmap, end: int) -> int:
    """Where the empty lines before ``end`` begin: behind the break of the last line that holds something."""
    while end > 1 and text[end - 1] in _BREAKS and text[end - 2] in _BREAKS:
        end -= 1
    return end
