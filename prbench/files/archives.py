"""ZIP archives that strangers hand in: looked at as a whole before a byte is unpacked, then unpacked into one folder.

What is taken is narrow, because prbench itself writes such archives (:func:`write_archive`): plain files under plain
names, one behind the other without gaps, and nothing before, between or behind them. So no two readers can see two
different archives in the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from prbench.errors import InputFileError
from prbench.files.bounded import foreign_input, open_regular, require, require_unpackable
from prbench.files.storage import atomic_path
from prbench.limits import HARMLESS_SIZE, LARGEST_PACKED, MOST_MEMBERS
from prbench.shown import quoted

# One part of a member's name: a name that a file can have on every system and that is no option of a command.
_PART = r"(?!(?:con|prn|aux|nul|com\d|lpt\d)(?:\.|/|$))[a-z0-9_][a-z0-9_.+=,-]{0,148}(?<!\.)"
_NAME = re.compile(f"{_PART}(?:/{_PART})*", re.IGNORECASE)
_END = struct.Struct("<4s4H2LH")
_LOCAL = struct.Struct("<4s5H3L2H")
_DIRECTORY_ENTRY = b"PK\x01\x02"
# Bytes of an entry of the table of contents: what is fixed, and the longest path of a file.
_LONGEST_ENTRY = 46 + 1024
# Flags of a member that mean nothing to a reader: how hard it was packed, and that its name is UTF-8.
_HARMLESS_FLAGS = 0b1000_0000_0110
# Bytes that one byte of the whole archive may unpack to; Parquet is packed already, and text is the smaller part.
_HIGHEST_COMPRESSION = 10
_PIECE = 2**20
_DAMAGED = "The file is damaged, or was not written by prbench; ask whoever made it for another copy."
_TIME = (1980, 1, 1, 0, 0, 0)


def write_archive(path: Path, members: Mapping[str, Path | bytes]) -> None:
    """Write files into an archive in the order given, whole or not at all; equal files give equal bytes.

    Args:
        path: The archive.
        members: Maps the name of each member to its file or its bytes.

    Raises:
        StorageError: if the archive cannot be written.
    """
    # Stored, because Parquet is packed already, and because no two versions of zlib pack text into the same bytes.
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            entry = zipfile.ZipInfo(name, _TIME)
            entry.external_attr = (stat.S_IFREG | 0o644) << 16
            entry.create_system = 3
            opened = io.BytesIO(content) if isinstance(content, bytes) else open_regular(content)
            with opened as source:
                size = source.seek(0, io.SEEK_END)
                source.seek(0)
                entry.file_size = size
                with archive.open(entry, "w") as target:
                    while piece := source.read(_PIECE):
                        target.write(piece)


@dataclass(frozen=True)
class Archive:
    """An archive that was looked at as a whole: every member is a plain file inside of it, of a harmless size."""

    path: Path
    members: Mapping[str, zipfile.ZipInfo]
    _opened: zipfile.ZipFile

    def pieces(self, name: str) -> Iterator[bytes]:
        """Yield the bytes of a member, never more of them than it declares.

        Raises:
            InputFileError: if it is damaged or ends too early.
        """
        member = self.members[name]
        left = member.file_size
        try:
            with self._opened.open(member) as source:
                while left and (piece := source.read(min(left, _PIECE))):
                    left -= len(piece)
                    yield piece
                source.read(1)  # the checksum is compared at the end
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
            raise _refused(self.path, name, "a member that can be unpacked", str(error)) from error
        if left:
            raise _refused(self.path, name, f"{member.file_size:,} bytes", f"{member.file_size - left:,}")

    def read(self, name: str) -> bytes:
        """Return the bytes of a small member.

        Raises:
            InputFileError: if it is larger than a harmless file, or damaged.
        """
        size = self.members[name].file_size
        if size > HARMLESS_SIZE:
            raise _refused(self.path, name, f"at most {HARMLESS_SIZE:,} bytes", f"{size:,}")
        return b"".join(self.pieces(name))

    def unpack(self, name: str, folder: Path) -> str:
        """Write a member to its place below a folder.

        Returns:
            SHA-256 of its bytes, as hexadecimal text.

        Raises:
            InputFileError: if it is damaged.
        """
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        digest = hashlib.sha256()
        with open(target, "xb") as file:  # never through a link, and never over another member
            for piece in self.pieces(name):
                digest.update(piece)
                file.write(piece)
        return digest.hexdigest()


@contextlib.contextmanager
def open_archive(path: Path) -> Iterator[Archive]:
    """Open an archive that a stranger handed in; nothing is unpacked before every member was looked at.

    Raises:
        InputFileError: if it is no ZIP archive, or one that leads out of its folder, hides or repeats members, unpacks
            to more than it can honestly hold, or holds anything but plain files; names the member.
    """
    with contextlib.ExitStack() as stack:
        with foreign_input(path):
            file = stack.enter_context(open_regular(path, largest=LARGEST_PACKED))
            start, count = _require_plain_end(path, file)
            try:
                archive = zipfile.ZipFile(file)
            except (zipfile.BadZipFile, UnicodeDecodeError, NotImplementedError, struct.error) as error:
                raise _refused(path, "its table of contents", "one of a whole ZIP archive", str(error)) from error
            entries = archive.infolist()
            if len(entries) != count:
                raise _refused(path, "its table of contents", f"{count} members, as its end says", f"{len(entries)}")
            for entry in entries:
                _require_plain_file(path, entry)
            _require_different(path, [entry.filename for entry in entries])
            total = sum(entry.file_size for entry in entries)
            most = max(HARMLESS_SIZE, _HIGHEST_COMPRESSION * path.stat().st_size)
            if total > most:
                raise _refused(path, "", f"members of at most {most:,} bytes altogether", f"{total:,} declared")
            _require_contiguous(path, file, entries, start)
        yield Archive(path, {entry.filename: entry for entry in entries}, archive)


def _require_plain_end(path: Path, file: io.BufferedReader) -> tuple[int, int]:
    """Look at the last bytes of an archive before its table of contents is read.

    Returns:
        Where the table of contents begins, and how many entries it has.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - _END.size, 0))
    found = file.read()
    if len(found) < _END.size or not found.startswith(b"PK\x05\x06"):
        expected = "a ZIP archive that ends with its end record"
        raise _refused(path, "", expected, "another file, a cut one, or bytes or a comment behind it")
    _, disk, first_disk, here, count, length, start, comment = _END.unpack(found)
    file.seek(max(size - _END.size - 20, 0))
    is_zip64 = file.read(4) == b"PK\x06\x07" or 0xFFFF in (here, count) or 0xFFFFFFFF in (length, start)
    fits = (disk, first_disk, comment) == (0, 0, 0) and here == count and start + length + _END.size == size
    most = f"at most {MOST_MEMBERS:,} members"
    require(
        path,
        (not is_zip64, "", f"{most} in a ZIP archive without ZIP64", "ZIP64, which is for more", _DAMAGED),
        (count <= MOST_MEMBERS, "", most, f"{count:,} declared", _DAMAGED),
        (
            fits,
            "its end record",
            "one that agrees with the file's size",
            "another (bytes before or behind it)",
            _DAMAGED,
        ),
        (length <= count * _LONGEST_ENTRY, "its table of contents", f"{count} entries", f"{length:,} bytes", _DAMAGED),
    )
    file.seek(start)
    # Counted before Python makes an object of each; a number in an entry may look like the beginning of another.
    entries = file.read(length).count(_DIRECTORY_ENTRY)
    if entries > 2 * count:
        raise _refused(path, "its table of contents", f"{count:,} entries, as its end says", f"{entries:,}")
    file.seek(0)
    return start, count


def _require_plain_file(path: Path, entry: zipfile.ZipInfo) -> None:
    """Refuse a member that is no plain file under a plain name, or unpacks to more than it can honestly hold."""
    # What the archive says, before Python mends it: it cuts names at a NUL, and turns backslashes on Windows.
    name = entry.orig_filename
    where = quoted(name)
    parts = PurePosixPath(name).parts
    leads_out = name.startswith("/") or "\\" in name or ":" in name or ".." in parts
    mode = entry.external_attr >> 16
    kind = "a plain file"
    if entry.is_dir():
        kind = "a folder"
    elif stat.S_IFMT(mode) not in (0, stat.S_IFREG):
        kind = "a link" if stat.S_ISLNK(mode) else "a device, pipe or folder"
    flags = entry.flag_bits & ~_HARMLESS_FLAGS
    remedy = "The archive was made to do harm, or not by prbench; do not unpack it by other means."
    plain_name = "a name of letters, digits and . _ - + = , that every system can store"
    require(
        path,
        (not leads_out, where, "a member inside the archive's folder", "a name that leads out of it", remedy),
        (kind == "a plain file", where, "a plain file", kind, remedy),
        (bool(_NAME.fullmatch(name)), where, plain_name, "another", remedy),
        (not flags & 1, where, "a member without a password", "an encrypted one", remedy),
        (not flags and not entry.extra and not entry.comment, where, "a member without extra fields", "some", _DAMAGED),
    )
    require_unpackable(path, entry, where=where)
    if entry.compress_type == zipfile.ZIP_STORED and entry.file_size != entry.compress_size:
        raise _refused(path, where, f"{entry.compress_size:,} bytes, as are stored", f"{entry.file_size:,} declared")


def _require_different(path: Path, names: Iterable[str]) -> None:
    """Refuse names that are one on a system which does not tell capitals from small letters, or file and folder."""
    seen: set[str] = set()
    folders: set[str] = set()
    for name in names:
        key = name.casefold()
        parents = {str(parent) for parent in PurePosixPath(key).parents}
        if key in seen or key in folders or parents & seen:
            raise _refused(path, name, "each member once", "it again, in other letters, or as file and folder at once")
        seen.add(key)
        folders |= parents


def _require_contiguous(path: Path, file: io.BufferedReader, entries: Iterable[zipfile.ZipInfo], end: int) -> None:
    """Refuse members that overlap, leave gaps, or say something else where they lie than in the table of contents."""
    place = 0
    for entry in sorted(entries, key=lambda each: each.header_offset):
        where = quoted(entry.filename)
        name = entry.filename.encode()
        file.seek(entry.header_offset)
        header = file.read(_LOCAL.size + len(name))
        stated = (entry.flag_bits, entry.compress_type, entry.CRC, entry.compress_size, entry.file_size, len(name), 0)
        said = None
        if len(header) == _LOCAL.size + len(name) and header.startswith(b"PK\x03\x04"):
            fields = _LOCAL.unpack(header[: _LOCAL.size])
            said = (*fields[2:4], *fields[6:])
        if entry.header_offset != place or said != stated or header[_LOCAL.size :] != name:
            expected = "members one behind the other, each with the header that the table of contents states"
            raise _refused(path, where, expected, "overlapping or hidden bytes, or another header")
        place += len(header) + entry.compress_size
    if place != end:
        raise _refused(path, "", "nothing between the members and the table of contents", f"{end - place:,} bytes")


def _refused(path: Path, where: str, expected: str, found: str) -> InputFileError:
    return InputFileError(path, where, expected=expected, found=found, remedy=_DAMAGED)
