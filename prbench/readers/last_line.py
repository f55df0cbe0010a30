"""Whether the last line of a CSV file that does not end in a line break is whole."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from prbench.bounded import open_regular
from prbench.errors import InputFileError

_HARMLESS = re.compile(rb"-?(0|\d\d+)\.\d{6,}|-?\d(\.\d+)?e-\d\d+")
"""Numbers that are the same to a millionth whatever may have been cut off: six decimals or more behind a 0 or behind
several digits, or a whole negative exponent. One digit before the point could be the mantissa of a lost exponent."""


def require_whole_last_line(
    path: Path, wanted: Collection[str], header: list[str], *, tail: bytes | None = None
) -> None:
    """Refuse a file whose last number may have been cut: a cut number still looks like one.

    A file that ends in a line break is whole. Without one it is taken as it is where nothing that is read could have
    changed: the last column is not read, or its last number does not depend on what may be missing. Lines that lack
    whole columns are found elsewhere.

    Args:
        path: The file.
        wanted: Columns that are read from it.
        header: All its columns.
        tail: Its last 80 bytes, where they are known; else they are read.

    Raises:
        InputFileError: saying what to do.
    """
    tail = _tail(path) if tail is None else tail
    if tail.endswith((b"\n", b"\r")):
        return
    last = tail.splitlines()[-1] if tail else b""
    if header[-1] not in wanted or _HARMLESS.fullmatch(last.rpartition(b",")[2].strip()):
        return
    found = f"'…{last[-40:].decode(errors='replace')}'" if last else "nothing"
    raise InputFileError(
        path,
        "last line",
        expected=f"a line break at its end (without one, the last '{header[-1]}' may have been cut)",
        found=found,
        remedy="Compare its size with the original: if it is smaller, the file is truncated; copy or download it again."
        " If it is complete, append one line break to the file.",
    )


def _tail(path: Path) -> bytes:
    with open_regular(path) as file:
        file.seek(0, 2)
        file.seek(max(file.tell() - 80, 0))
        return file.read()
