"""Files read whole or by lines, and never more of them than any format holds: sizes are looked at before contents.

The boundary between files that other people wrote and the code that reads them.

Every function through which such files are read stands behind :func:`foreign_input`. A reader foresees much, never
everything: what it did not foresee leaves it as some exception of Python, NumPy or Arrow. Here that becomes the one
message that a damaged file deserves, so that no list of exceptions has to be complete anywhere else.
"""

from __future__ import annotations

import contextlib
import enum
import io
import os
import re
import shutil
import stat
import tomllib
import typing
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

import msgspec

from prbench.errors import InputFileError, PrbenchError, UnforeseenInput, did_you_mean
from prbench.limits import (
    HARMLESS_SIZE,
    HIGHEST_COMPRESSION,
    LARGEST_ARCHIVE,
    LARGEST_FILE,
    LARGEST_UNPACKED,
    LONGEST_LINE,
)

Form = TypeVar("Form")
_COPY_AGAIN = "The file may be damaged; copy or download it again."
_TOO_LARGE = "This is another file, or a damaged one."
_OF_THE_KERNEL = ("/proc/", "/sys/")
_WELL_KNOWN = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


def require(path: Path | str, *checks: tuple[Any, str, str, object, str]) -> None:
    """Refuse a file at the first of some checks that fails.

    Args:
        path: The file, for the message.
        checks: Rows of whether it holds, where in the file, what is expected, what is found, and what to do about it.

    Raises:
        InputFileError: for the first check that does not hold.
    """
    for holds, where, expected, found, remedy in checks:
        if not holds:
            raise InputFileError(path, where, expected=expected, found=str(found), remedy=remedy)


def require_rows(
    path: Path | str,
    bad: Any,  # a NumPy array: every command's help would have to import NumPy for the type
    expected: str | Callable[[int], str],
    found: str | Callable[[int], str],
    *,
    place: str = "line",
    first: int = 2,
    column: str = "",
    remedy: str = "",
) -> None:
    """Refuse a file at the first of its rows that is bad.

    Args:
        path: The file, for the message.
        bad: Array of truth values, one a row.
        expected: What the row should hold; a function of the row's index (from 0) where it depends on the row.
        found: What it holds instead.
        place: What a row is called in the message.
        first: Number of the first row there.
        column: The column that is bad; empty where the whole row is.
        remedy: What to do about it.

    Raises:
        InputFileError: naming the first bad row.
    """
    if bad.any():
        row = int(bad.argmax())
        said = [text if isinstance(text, str) else text(row) for text in (expected, found)]
        where = f"{place} {row + first}" + (f", column '{column}'" if column else "")
        raise InputFileError(path, where, expected=said[0], found=said[1], remedy=remedy)


def read_whole(path: Path, *, largest: int = LARGEST_FILE) -> bytes:
    """Read all bytes of a file.

    Args:
        path: The file.
        largest: Bytes beyond which it is refused unread.

    Raises:
        InputFileError: if it is larger, or no file but a folder, a pipe or a device, which may never end.
        OSError: if it is missing or cannot be read.
    """
    with open_regular(path, largest=largest) as file:
        return file.read()


def read_text(path: Path, *, expected: str = "", remedy: str = "", largest: int = LARGEST_FILE) -> str:
    """Return the text of a file, line breaks as Python has them.

    Args:
        path: The file.
        expected: Name of such files, for messages; without it a missing one is left to the caller.
        remedy: What to do if it is missing or no text, for messages.
        largest: Bytes beyond which it is refused unread.

    Raises:
        InputFileError: see :func:`read_whole`; also if it is no text in UTF-8.
        OSError: see :func:`read_whole`.
    """
    try:
        with io.TextIOWrapper(open_regular(path, largest=largest), encoding="utf-8-sig") as file:
            return file.read()
    except FileNotFoundError as error:
        if not expected:
            raise
        raise InputFileError(path, "", expected=expected, found="no such file", remedy=remedy) from error
    except UnicodeDecodeError as error:
        raise InputFileError(
            path, "", expected="text in UTF-8", found=f"other bytes ({error})", remedy=remedy or _COPY_AGAIN
        ) from error


def require_size(path: Path, *, largest: int = LARGEST_FILE, opened: int | None = None) -> int:
    """Refuse what is no regular file, or larger than any file of its kind; reading pipes and devices may never end.

    Args:
        path: The file, or a link to it.
        largest: Bytes beyond which it is refused.
        opened: Its descriptor, where it is open already.

    Returns:
        The size of the file, bytes.

    Raises:
        InputFileError: saying what stands there, or how large it may be.
        OSError: if it is missing.
    """
    status = path.stat() if opened is None else os.fstat(opened)
    found = "" if stat.S_ISREG(status.st_mode) else "a pipe or a device"
    if stat.S_ISDIR(status.st_mode):
        found = "a folder"
    # The kernel's own files call themselves regular and empty; /proc/kmsg waits until there is news.
    elif status.st_size == 0 and os.path.realpath(path).startswith(_OF_THE_KERNEL):
        found = "a file of the operating system"
    require(path, (not found, "", "a file", found, ""))
    require(path, (status.st_size <= largest, "", f"at most {largest:,} bytes", f"{status.st_size:,}", _TOO_LARGE))
    return status.st_size


def open_regular(path: Path, *, largest: int = LARGEST_ARCHIVE) -> io.BufferedReader:
    """Open a file for reading bytes; every file of a user that Python itself reads is opened here.

    Raises:
        InputFileError: see :func:`require_size`.
        OSError: if it is missing or cannot be read.
    """
    require_size(path, largest=largest)  # looking comes first, because opening a device may do something
    # Waiting for the writer of a pipe that somebody put there a moment ago may never end.
    flag = getattr(os, "O_NONBLOCK", 0)
    file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | flag))  # noqa: SIM115 - its reader closes it
    try:
        require_size(path, largest=largest, opened=file.fileno())
    except BaseException:
        file.close()
        raise
    return file


def read_end(path: Path, most: int) -> bytes:
    """Return the last bytes of a file, at most so many (see :func:`open_regular` for what it raises)."""
    with open_regular(path) as file:
        file.seek(max(os.fstat(file.fileno()).st_size - most, 0))
        return file.read(most)


def whole_lines(file: BinaryIO, path: Path) -> Iterator[bytes]:
    """Yield the lines of an open file with their breaks.

    Raises:
        InputFileError: naming the first line that is longer than any line of a text file.
    """
    number = 1
    while line := file.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise too_long_line(path, f"line {number}")
        yield line
        number += 1


def too_long_line(path: Path, where: str) -> InputFileError:
    """Return the error for a line that no text file has."""
    return InputFileError(
        path, where, expected=f"lines of at most {LONGEST_LINE:,} bytes", found="a longer one", remedy=_TOO_LARGE
    )


def require_unpackable(path: Path, member: zipfile.ZipInfo, *, where: str = "") -> None:
    """Refuse a member of a ZIP archive that declares more bytes than it can honestly hold; call before opening it.

    Args:
        path: What messages name.
        member: Its entry in the archive's table of contents.
        where: The member, where ``path`` is the archive.

    Raises:
        InputFileError: if it declares too many bytes, altogether or for those that are stored; or if it is packed in
            another way than those two whose unpacking can be stopped at any byte.
    """
    most = min(max(HARMLESS_SIZE, HIGHEST_COMPRESSION * member.compress_size), LARGEST_UNPACKED)
    packing = f"compression number {member.compress_type}"
    expected = f"at most {most:,} bytes in {member.compress_size:,} packed ones"
    remedy = "The archive is damaged, or made to fill the memory; download it again from its origin."
    require(path, (member.compress_type in _WELL_KNOWN, where, "a member stored or deflated", packing, ""))
    require(path, (member.file_size <= most, where, expected, f"{member.file_size:,} declared", remedy))


def read_toml(path: Path, expected: str = "a TOML file", remedy: str = "") -> dict[str, Any]:
    """Read a TOML file.

    Args:
        path: The file.
        expected: Name of such files, for messages.
        remedy: What to do if it is missing or damaged, for messages.

    Raises:
        InputFileError: if it is missing, too large, no file or no TOML (naming line and column).
    """
    try:
        return tomllib.loads(read_text(path, expected=expected, remedy=remedy, largest=HARMLESS_SIZE))
    except tomllib.TOMLDecodeError as error:
        raise InputFileError(path, "", expected="a TOML file", found=str(error), remedy=remedy) from error


def as_path(kind: type, value: Any) -> Any:
    """Make a path of a text, for conversions to classes that have paths."""
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError(f"values of the type {kind}")


def allowed_values(error: msgspec.ValidationError, form: type) -> str:
    """Return a sentence for the end of a message, with a leading space, that lists the values a key may have.

    Args:
        error: The error that ``msgspec.convert`` raised.
        form: The class that was to be made.

    Returns:
        The sentence; empty where the values are no list.
    """
    values = _values_of(_refused_kind(error, form))
    return f" It is one of: {', '.join(map(str, values))}." if values else ""


def _refused_kind(error: msgspec.ValidationError, form: type) -> Any:
    """Return the type that a conversion expected where it failed: a class with fields, a list of values, or another."""
    place = str(error).partition(" - at `$.")[2]
    kind: Any = form
    for key in re.sub(r"\[.*?\]|`", "", place).split(".") if place else []:
        if isinstance(kind, msgspec.StructMeta):
            kind = {field.name: field.type for field in msgspec.structs.fields(typing.cast(Any, kind))}.get(key)
        # One kind of two may be None; that of what a list or table holds.
        inner = (each for each in typing.get_args(kind) if isinstance(each, msgspec.StructMeta) or _values_of(each))
        kind = next(inner, kind)
    return kind


def _values_of(kind: Any) -> tuple[Any, ...]:
    """Return the values of a ``Literal`` or an enumeration; nothing for other types."""
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return tuple(member.value for member in kind)
    return typing.get_args(kind) if typing.get_origin(kind) is typing.Literal else ()


def structured(path: Path, values: Any, form: type[Form], *, remedy: str = "") -> Form:
    """Turn the content of a file into a data class.

    Args:
        path: The file, for messages.
        values: Its content.
        form: A class of msgspec, which may hold others.
        remedy: What to do about it where no key is nearly right, for messages.

    Raises:
        InputFileError: for an unknown key (with the nearest known one), a missing key, or a value of another kind
            (with those that it may have, where they are a list).
    """
    try:
        return msgspec.convert(values, form, dec_hook=as_path)
    except msgspec.ValidationError as error:
        said, _, place = str(error).partition(" - at `$.")
        kind = _refused_kind(error, form)
        known = getattr(kind, "__struct_fields__", _values_of(kind))
        named = re.search(r"unknown field `(.+)`", said)
        remedy = (named and did_you_mean(named[1], known).strip()) or remedy
        expected = f"what is known here: {', '.join(map(str, known))}" if known else "a value of the key's type"
        if error.__cause__ is not None:  # what the class itself says of its values
            expected = "values that fit together"
        raise InputFileError(path, place.rstrip("`"), expected=expected, found=said, remedy=remedy) from error


# Attributes by which the objects that readers pass around name the file or folder that they stand for.
_PLACES = ("shown", "path", "folder", "root")


@contextlib.contextmanager
def foreign_input(place: Path | str = "input") -> Iterator[None]:
    """Let nothing but errors of prbench, and ``MemoryError``, out of a block or function that reads foreign files.

    The message names the file that was being read: the one that the system's error names, else the path that the
    innermost function of prbench was working on.

    Args:
        place: Named if no path can be found; a file or folder.

    Raises:
        InputFileError: for a file that cannot be opened or read (a folder, a looping link, no permission), nests too
            deep, or is no text.
        UnforeseenInput: for everything else, naming the kind of the original error, which is its cause.
    """
    try:
        yield
    except (PrbenchError, MemoryError):
        raise
    except Exception as error:
        kind = InputFileError
        expected = "a file that can be read"
        if isinstance(error, RecursionError):
            expected = "values nested at most some hundred levels deep"
            found = "more"
        elif isinstance(error, UnicodeDecodeError):
            expected = "text in UTF-8"
            found = f"other bytes ({error})"
        elif isinstance(error, OSError) and error.strerror:
            found = error.strerror
        elif isinstance(error, RuntimeError) and str(error).startswith("Symlink loop"):  # of Path.resolve
            found = "a link that leads to itself"
        else:
            kind = UnforeseenInput
            expected = "content that prbench can read"
            found = f"what ends in {type(error).__name__}: {error}"
        raise kind(file_of(error) or place, "", expected=expected, found=found, remedy=_COPY_AGAIN) from error


def copy_file(path: Path, target: Path) -> None:
    """Copy a file's bytes over another file (see :func:`open_regular` for what it raises)."""
    with open_regular(path) as source, open(target, "wb") as copy:
        shutil.copyfileobj(source, copy)


def file_of(error: Exception) -> Path | None:
    """Return the file that was being worked on when an error arose; None where nothing tells."""
    named = error.filename if isinstance(error, OSError) else None
    if isinstance(named, str | bytes):
        return Path(os.fsdecode(named))
    # The path that the innermost function of prbench knew when an error arose; None if none knew one.
    traceback = error.__traceback__
    found = None
    while traceback is not None:
        frame = traceback.tb_frame
        ours = str(frame.f_globals.get("__name__")).startswith("prbench")
        if ours and frame.f_code.co_name != "foreign_input":  # which knows the folder alone
            found = next(filter(None, map(_path_of, frame.f_locals.values())), None) or found
        traceback = traceback.tb_next
    return found


def _path_of(value: object) -> Path | None:
    if isinstance(value, Path):
        return value
    if not str(type(value).__module__).startswith("prbench"):
        return None
    return next((path for name in _PLACES if isinstance(path := getattr(value, name, None), Path)), None)
