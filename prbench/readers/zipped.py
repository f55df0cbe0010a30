"""Files inside zip archives, read where they are: nothing is unpacked to the disk."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from prbench.errors import InputFileError
from prbench.files.bounded import read_end, read_whole, require_size, require_unpackable
from prbench.limits import LARGEST_ARCHIVE, LARGEST_FILE, LARGEST_UNPACKED
from prbench.readers.found import InputFile

_PIECE = 2**20
_COPY_AGAIN = "The archive may be truncated; copy or download it again."


@dataclass(frozen=True)
class ZippedFile:
    """One file inside a zip archive."""

    archive: Path
    member: str

    def __str__(self) -> str:
        return str(self.shown)

    @property
    def shown(self) -> Path:
        """Return its name in messages."""
        return self.archive / self.member

    @property
    def name(self) -> str:
        """Its own name, without folders."""
        return self.member.rpartition("/")[2]


Source = Path | ZippedFile


def source_of(file: InputFile) -> Source:
    """Return what to read of an input file: itself, or its member of an archive."""
    return ZippedFile(file.path, file.member) if file.member else file.path


def shown(source: Source) -> Path:
    """Return a source's name in messages."""
    return source if isinstance(source, Path) else source.shown


def archive_members(archive: Path) -> dict[str, int]:
    """Names of the files in an archive, with their sizes in bytes when unpacked.

    Raises:
        InputFileError: if it is no zip archive, or its table of contents is damaged.
    """
    require_size(archive, largest=LARGEST_ARCHIVE)
    try:
        with zipfile.ZipFile(archive) as opened:
            return {entry.filename: entry.file_size for entry in opened.infolist() if not entry.is_dir()}
    except zipfile.BadZipFile as error:
        raise InputFileError(
            archive, "", expected="a whole zip archive", found=str(error), remedy=_COPY_AGAIN
        ) from error


@contextmanager
def opened(source: Source) -> Iterator[io.BufferedIOBase]:
    """The bytes of a source as a stream; a damaged archive becomes an error that says what to do.

    Raises:
        InputFileError: if there is no such file or member, it is too large, or the archive is damaged or encrypted.
            Damage shows where it is reached: the checksum of a member is compared at its end.
        FileNotFoundError: if a plain file is missing.
    """
    if isinstance(source, Path):
        require_size(source, largest=LARGEST_UNPACKED)
        with open(source, "rb") as file:
            yield file
        return
    with ExitStack() as stack:
        file = _opened_member(source, stack)
        try:
            yield file
        except (zipfile.BadZipFile, zlib.error, EOFError) as error:
            raise _damaged(source, error) from error


def _opened_member(source: ZippedFile, stack: ExitStack) -> io.BufferedIOBase:
    require_size(source.archive, largest=LARGEST_ARCHIVE)
    try:
        archive = stack.enter_context(zipfile.ZipFile(source.archive))
        member = archive.getinfo(source.member)
        require_unpackable(source.shown, member)
        return cast(io.BufferedIOBase, stack.enter_context(archive.open(member)))
    except KeyError as error:
        raise InputFileError(source.archive, "", expected=f"the file {source.member} in it", found="none") from error
    except (zipfile.BadZipFile, EOFError, RuntimeError, NotImplementedError) as error:  # the latter two: encrypted
        raise _damaged(source, error) from error


def _damaged(source: ZippedFile, error: Exception) -> InputFileError:
    return InputFileError(
        source.shown, "", expected="a file that can be unpacked", found=str(error), remedy=_COPY_AGAIN
    )


def read_all(source: Source, *, largest: int = LARGEST_FILE) -> bytes:
    """All bytes of a source (see :func:`opened` for what it raises).

    Args:
        source: A plain file, or one in an archive.
        largest: Bytes beyond which it is refused.

    Raises:
        InputFileError: see :func:`opened`, or if the source is larger.
    """
    if isinstance(source, Path):
        return read_whole(source, largest=largest)
    content = bytearray()
    with opened(source) as file:
        # By pieces: one call for everything would unpack all that is there, however little the archive declares.
        while piece := file.read(_PIECE):
            content += piece
            if len(content) > largest:
                raise InputFileError(source.shown, "", expected=f"at most {largest:,} bytes", found="more")
    return bytes(content)


class RememberingTail(io.RawIOBase):
    """A stream that passes on what another one reads and remembers the end of it."""

    LENGTH = 80

    def __init__(self, stream: io.BufferedIOBase) -> None:
        self._stream = stream
        self.tail = b""

    def readable(self) -> bool:
        """It can be read."""
        return True

    def read(self, size: int = -1) -> bytes:
        """See :class:`io.RawIOBase`."""
        content = self._stream.read(size)
        if content:
            self.tail = (self.tail + content[-self.LENGTH :])[-self.LENGTH :]
        return content


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
    tail = read_end(path, RememberingTail.LENGTH) if tail is None else tail
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
