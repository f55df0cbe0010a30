"""ZIP archives that strangers hand in: looked at as a whole before a byte of them is unpacked.

What is taken is narrow, because prbench itself writes such archives (:func:`write_archive`): plain files under plain
names, one behind the other without gaps, and nothing before, between or behind them. So no two readers can see two
different archives in the same bytes.
"""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
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
_HEADER = struct.Struct("<4s5H3L2H")
# Bytes of an entry of the table of contents: what is fixed, and the longest path of a file.
_LONGEST_ENTRY = 46 + 1024
# Flags of a member that mean nothing to a reader: how hard it was packed, and that its name is UTF-8.
_HARMLESS_FLAGS = 0b1000_0000_0110
# Bytes that one byte of the whole archive may unpack to; Parquet is packed already, and text is the smaller part.
_HIGHEST_COMPRESSION = 10
_OTHER = "The file is damaged, or was not written by prbench; ask whoever made it for another copy."
_HOSTILE = "The archive is damaged or was made to do harm; do not unpack it by other means."


def write_archive(path: Path, members: Mapping[str, Path | bytes]) -> None:
    """Write files into an archive in the order given, whole or not at all; equal files give equal bytes.

    Args:
        path: The archive.
        members: Maps the name of each member to its file or its bytes.

    Raises:
        InputFileError: if a name is not one that :func:`open_archive` takes.
        StorageError: if the archive cannot be written.
    """
    # Stored, because Parquet is packed already, and because no two versions of zlib pack text into the same bytes.
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            require(path, (_NAME.fullmatch(name), name, _PLAIN_NAME, "another", "Give the run's folder another name."))
            entry = zipfile.ZipInfo(name)  # its time is the first that the form knows, so that no clock is in the bytes
            entry.create_system = 3
            entry.external_attr = (stat.S_IFREG | 0o644) << 16
            opened = io.BytesIO(content) if isinstance(content, bytes) else open_regular(content)
            with opened as source, archive.open(entry, "w") as target:
                shutil.copyfileobj(source, target)


_PLAIN_NAME = "a name of letters, digits and . _ - + = , that every system can store"


@contextlib.contextmanager
def open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive that a stranger handed in; every member was looked at before the block begins.

    Its members can be unpacked by their names below any folder; none yields more bytes than it declares.

    Raises:
        InputFileError: if it is no ZIP archive, or one that leads out of its folder, hides or repeats members, unpacks
            to more than it can honestly hold, or holds anything but plain files; names the member. In the block: if a
            member is damaged.
    """
    with contextlib.ExitStack() as stack:
        try:
            with foreign_input(path):
                file = stack.enter_context(open_regular(path, largest=LARGEST_PACKED))
                start, count = _require_plain_end(path, file)
            archive = zipfile.ZipFile(file)
            with foreign_input(path):
                _require_plain_members(path, file, archive.infolist(), start, count)
            yield archive
        except (zipfile.BadZipFile, zlib.error, EOFError, UnicodeDecodeError, NotImplementedError) as error:
            raise InputFileError(path, "", expected="a whole ZIP archive", found=str(error), remedy=_OTHER) from error


def _require_plain_end(path: Path, file: io.BufferedReader) -> tuple[int, int]:
    """Look at the last bytes of an archive, before its table of contents is read.

    Returns:
        Where the table of contents begins, and how many entries it has.
    """
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - _END.size - 20, 0))
    end = file.read()
    found = end[-_END.size :]
    is_zip = len(found) == _END.size and found.startswith(b"PK\x05\x06")
    require(path, (is_zip, "", "a ZIP archive", "another file, a cut one, or one with bytes behind its end", _OTHER))
    _, disk, first_disk, here, count, length, start, comment = _END.unpack(found)
    is_zip64 = end.startswith(b"PK\x06\x07") or 0xFFFF in (here, count) or 0xFFFFFFFF in (length, start)
    fits = (disk, first_disk, comment, here) == (0, 0, 0, count) and start + length + _END.size == size
    most = f"at most {MOST_MEMBERS:,} members"
    require(
        path,
        (not is_zip64, "", f"{most} in a ZIP archive without ZIP64", "ZIP64, which is for more", _HOSTILE),
        (count <= MOST_MEMBERS, "", most, f"{count:,} declared", _HOSTILE),
        (fits, "its end", "one that agrees with the size of the file", "another: bytes are missing or hidden", _OTHER),
        (length <= count * _LONGEST_ENTRY, "its end", f"a table of {count:,} members", f"{length:,} bytes", _HOSTILE),
    )
    file.seek(start)
    # Counted before Python makes an object of each; a number in an entry may look like the beginning of another.
    entries = file.read(length).count(b"PK\x01\x02")
    require(path, (entries <= 2 * count, "its end", f"{count:,} members", f"{entries:,} listed", _HOSTILE))
    file.seek(0)
    return start, count


def _require_plain_members(
    path: Path, file: io.BufferedReader, entries: list[zipfile.ZipInfo], start: int, count: int
) -> None:
    """Refuse an archive unless all members are plain files that lie behind one another up to its table of contents."""
    require(path, (len(entries) == count, "its end", f"{count:,} members", f"{len(entries):,} listed", _HOSTILE))
    names: set[str] = set()
    folders: set[str] = set()
    for entry in entries:
        _require_plain_file(path, entry)
        # Some systems do not tell capitals from small letters.
        name = PurePosixPath(entry.filename.casefold())
        parents = {str(parent) for parent in name.parents}
        once = str(name) not in names | folders and names.isdisjoint(parents)
        found = "it again, in other letters, or as file and folder"
        require(path, (once, quoted(entry.filename), "each member once", found, _HOSTILE))
        names.add(str(name))
        folders |= parents
    declared = sum(entry.file_size for entry in entries)
    most = max(HARMLESS_SIZE, _HIGHEST_COMPRESSION * start)
    require(path, (declared <= most, "", f"at most {most:,} bytes unpacked", f"{declared:,} declared", _HOSTILE))
    place = 0
    for entry in sorted(entries, key=lambda each: each.header_offset):
        name = entry.filename.encode()
        file.seek(entry.header_offset)
        header = file.read(_HEADER.size + len(name))
        sizes = (entry.compress_size, entry.file_size, len(name), 0)
        stated = (b"PK\x03\x04", entry.flag_bits, entry.compress_type, entry.CRC, *sizes)
        found = ()
        if len(header) == _HEADER.size + len(name):
            mark, _, flags, packing, _, _, *rest = _HEADER.unpack(header[: _HEADER.size])
            found = (mark, flags, packing, *rest)
        fits = entry.header_offset == place and found == stated and header.endswith(name)
        expected = "members behind one another, each with the header that the table of contents states"
        require(path, (fits, quoted(entry.filename), expected, "overlapping or hidden bytes", _HOSTILE))
        place += len(header) + entry.compress_size
    require(path, (place == start, "", "nothing behind the last member", f"{start - place:,} bytes", _HOSTILE))


def _require_plain_file(path: Path, entry: zipfile.ZipInfo) -> None:
    """Refuse a member that is no plain file under a plain name, or declares more than it can honestly hold."""
    # The name as the archive has it: Python cuts it at a NUL, and turns backslashes on Windows.
    name = entry.orig_filename
    where = quoted(name)
    inside = not (name.startswith("/") or "\\" in name or ":" in name or ".." in PurePosixPath(name).parts)
    attributes = entry.external_attr  # of Unix above, of MS-DOS below, where 16 is a folder
    is_file = not (name.endswith("/") or attributes & 16) and stat.S_IFMT(attributes >> 16) in (0, stat.S_IFREG)
    plain = not (entry.flag_bits & ~_HARMLESS_FLAGS or entry.extra or entry.comment)
    stored = entry.compress_type != zipfile.ZIP_STORED or entry.file_size == entry.compress_size
    require(
        path,
        (inside, where, "a member inside the archive's folder", "a name that leads out of it", _HOSTILE),
        (is_file, where, "a plain file", "a folder, a link or a device", _HOSTILE),
        (_NAME.fullmatch(name), where, _PLAIN_NAME, "another", _HOSTILE),
        (not entry.flag_bits & 1, where, "a member without a password", "an encrypted one", _HOSTILE),
        (plain, where, "a member without extra fields", "some", _OTHER),
        (stored, where, f"{entry.compress_size:,} bytes, as are stored", f"{entry.file_size:,} declared", _HOSTILE),
    )
    require_unpackable(path, entry, where=where)
