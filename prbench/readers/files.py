"""Files of native recordings, plain or in zip archives: CSV and JSON by name, checked, refused with place and remedy.

Nothing is unpacked to the disk.
"""

from __future__ import annotations

import contextlib
import csv
import dataclasses
import io
import re
import zipfile
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Bool, Float, Int

from prbench import limits
from prbench.errors import InputFileError
from prbench.files import bounded
from prbench.files.bounded import read_text
from prbench.readers.found import InputFile
from prbench.recording import UnreadableEntry

Points = Float[np.ndarray, "n 3"]
Triangles = tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"]]  # vertices, and their numbers by triangle
Rotations = Float[np.ndarray, "n 4"]

_PIECE = 2**20
_COPY_ARCHIVE_AGAIN = "The archive may be truncated; copy or download it again."


Source = Path | InputFile  # a plain file, or one inside a zip archive


def source_of(file: InputFile) -> Source:
    """Return what to read of an input file: itself, or its member of an archive."""
    return file if file.member else file.path


def shown(source: Source) -> Path:
    """Return a source's name in messages."""
    return source if isinstance(source, Path) else source.path / source.member


def archive_members(archive: Path) -> dict[str, int]:
    """Return the names of the files in an archive, with their sizes in bytes when unpacked.

    Raises:
        InputFileError: if it is no zip archive, or its table of contents is damaged.
    """
    try:
        with bounded.open_regular(archive) as file, zipfile.ZipFile(file) as content:
            return {entry.filename: entry.file_size for entry in content.infolist() if not entry.is_dir()}
    except zipfile.BadZipFile as error:
        expected = "a whole zip archive"
        raise InputFileError(archive, "", expected=expected, found=str(error), remedy=_COPY_ARCHIVE_AGAIN) from error


@contextlib.contextmanager
def opened(source: Source) -> Iterator[io.BufferedIOBase]:
    """Return the bytes of a source as a stream; a damaged archive becomes an error that says what to do.

    Raises:
        InputFileError: if there is no such file or member, it is too large, or the archive is damaged or encrypted.
            Damage shows where it is reached: the checksum of a member is compared at its end.
        FileNotFoundError: if a plain file is missing.
    """
    if isinstance(source, Path):
        with bounded.open_regular(source, largest=limits.LARGEST_UNPACKED) as file:
            yield file
        return
    name = shown(source)
    damaged = partial(InputFileError, name, "", expected="a file that can be unpacked", remedy=_COPY_ARCHIVE_AGAIN)
    with contextlib.ExitStack() as stack:
        try:
            archive = stack.enter_context(zipfile.ZipFile(stack.enter_context(bounded.open_regular(source.path))))
            member = archive.getinfo(source.member)
            bounded.require_unpackable(name, member)
            file = cast(io.BufferedIOBase, stack.enter_context(archive.open(member)))
        except KeyError as error:
            raise InputFileError(source.path, "", expected=f"the file {source.member} in it", found="none") from error
        except (zipfile.BadZipFile, EOFError, RuntimeError, NotImplementedError) as error:  # the latter two: encrypted
            raise damaged(found=str(error)) from error
        try:
            yield file
        except (zipfile.BadZipFile, zlib.error, EOFError) as error:
            raise damaged(found=str(error)) from error


def read_all(source: Source, *, largest: int = limits.LARGEST_FILE) -> bytes:
    """Read all bytes of a source (see :func:`opened` for what it raises).

    Args:
        source: A plain file, or one in an archive.
        largest: Bytes beyond which it is refused.

    Raises:
        InputFileError: see :func:`opened`, or if the source is larger.
    """
    if isinstance(source, Path):
        return bounded.read_whole(source, largest=largest)
    content = bytearray()
    with opened(source) as file:
        # By pieces: one call for everything would unpack all that is there, however little the archive declares.
        while piece := file.read(_PIECE):
            content += piece
            if len(content) > largest:
                raise InputFileError(shown(source), "", expected=f"at most {largest:,} bytes", found="more")
    return bytes(content)


class _RememberingTail(io.RawIOBase):
    """A stream that passes on what another one reads and remembers the end of it."""

    LENGTH = 80

    def __init__(self, stream: io.BufferedIOBase) -> None:
        self._stream = stream
        self.tail = b""

    def readable(self) -> bool:
        """Return True: it can be read."""
        return True

    def read(self, size: int = -1) -> bytes:
        """See :class:`io.RawIOBase`."""
        content = self._stream.read(size)
        if content:
            self.tail = (self.tail + content[-self.LENGTH :])[-self.LENGTH :]
        return content


# Numbers that are the same to a millionth whatever may have been cut off: six decimals or more behind a 0 or behind
# several digits, or a whole negative exponent. One digit before the point could be the mantissa of a lost exponent.
_HARMLESS = re.compile(rb"-?(0|\d\d+)\.\d{6,}|-?\d(\.\d+)?e-\d\d+")


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
    tail = bounded.read_end(path, _RememberingTail.LENGTH) if tail is None else tail
    if tail.endswith((b"\n", b"\r")):
        return
    last = tail.splitlines()[-1] if tail else b""
    if header[-1] not in wanted or _HARMLESS.fullmatch(last.rpartition(b",")[2].strip()):
        return
    found = f"'…{last[-40:].decode(errors='replace')}'" if last else "nothing"
    expected = f"a line break at its end (without one, the last '{header[-1]}' may have been cut)"
    remedy = "Compare its size with the original: if it is smaller, the file is truncated; copy or download it again."
    remedy += " If it is complete, append one line break to the file."
    raise InputFileError(path, "last line", expected=expected, found=found, remedy=remedy)


# A time in a JSON file; NumPy has no larger integers.
Nanoseconds = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
# A coordinate in a JSON file; no recording reaches farther.
Metres = Annotated[float, msgspec.Meta(ge=-limits.FARTHEST_POSITION, le=limits.FARTHEST_POSITION)]
Column = type[int] | type[float] | type[str]
Encoded = TypeVar("Encoded")
Decoded = TypeVar("Decoded")

_ARROW_TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string()}
_QUATERNION_TOLERANCE = 1e-3
# Bytes of a plain text file from which on it is read in pieces, which is slower; of a shorter one no more can come than
# a few times as much.
_WATCHED_SIZE = 2**28
_BLOCK = 2**21  # bytes
_COPY_AGAIN = "The file may be truncated; copy or download it again."
_SORT = "The clock runs backwards or a row is repeated; sort the rows by time and remove repeated ones."


@bounded.foreign_input()
def read_columns(path: Source, columns: Mapping[str, Column]) -> pa.Table:
    """Read the named columns of a CSV file; further columns and their order do not matter.

    Args:
        path: CSV with a header line, plain or in an archive.
        columns: Name and type of each column. Empty numbers become NaN; integers must not be empty.

    Raises:
        InputFileError: if the file or a column is missing, a line is cut, or a value is no number.
    """
    header = read_header(path)
    require_column_names(path, header, columns)
    if isinstance(path, Path) and bounded.require_size(path, largest=limits.LARGEST_UNPACKED) < _WATCHED_SIZE:
        with contextlib.suppress(pa.ArrowInvalid, pa.ArrowKeyError):  # reading by blocks names the row
            table = pyarrow.csv.read_csv(path, convert_options=_conversion(columns))
            require_whole_last_line(path, columns, header)
            require_integers(path, table, columns)
            return table
    # The table of a long file is refused as soon as it is larger than any: cells may be longer than their text.
    kept = [pa.schema([(name, _ARROW_TYPES[kind]) for name, kind in columns.items()]).empty_table()]
    size = 0
    for block in read_blocks(path, columns):
        kept.append(block)
        size += block.nbytes
        found = f"more in the first {sum(map(len, kept)):,} rows"
        expected = f"columns of at most {limits.LARGEST_TABLE:,} bytes"
        bounded.require(shown(path), (size <= limits.LARGEST_TABLE, "", expected, found, ""))
    return pa.concat_tables(kept).combine_chunks()


def read_blocks(path: Source, columns: Mapping[str, Column]) -> Iterator[pa.Table]:
    """Read the named columns as :func:`read_columns` does, block by block, so that a long file needs little memory."""
    header = read_header(path)
    require_column_names(path, header, columns)
    options = pyarrow.csv.ReadOptions(block_size=_BLOCK, use_threads=False)
    row = 2
    with opened(path) as file:
        stream = _RememberingTail(file)
        try:
            for batch in pyarrow.csv.open_csv(stream, read_options=options, convert_options=_conversion(columns)):
                table = pa.Table.from_batches([batch])
                require_integers(path, table, columns, first=row)
                row += len(table)
                yield table
        except (pa.ArrowInvalid, pa.ArrowKeyError) as error:  # a key where blanks stand around a column's name
            found = str(error).splitlines()[0]
            named = re.search(r"Row #(\d+)", found)
            where = f"line {named[1]}" if named else ""
            expected = "complete lines of comma-separated values of the right kind"
            found = f"'{found[:160]}'"
            raise InputFileError(shown(path), where, expected=expected, found=found, remedy=_COPY_AGAIN) from error
    require_whole_last_line(shown(path), columns, header, tail=stream.tail)


def _conversion(columns: Mapping[str, Column]) -> pyarrow.csv.ConvertOptions:
    types = {name: _ARROW_TYPES[kind] for name, kind in columns.items()}
    return pyarrow.csv.ConvertOptions(column_types=types, include_columns=list(columns))


def require_column_names(path: Source, header: list[str], columns: Iterable[str]) -> None:
    """Refuse a file that lacks a column.

    Raises:
        InputFileError: naming the first one.
    """
    if missing := [name for name in columns if name not in header]:
        found = f"the columns {', '.join(name or '(unnamed)' for name in header)}"
        remedy = "This is another file, or another version of the format."
        raise InputFileError(shown(path), "header", expected=f"a column '{missing[0]}'", found=found, remedy=remedy)


def require_integers(path: Source, table: pa.Table, columns: Mapping[str, Column], *, first: int = 2) -> None:
    """Refuse empty cells where integers are needed; ``first`` is the line of the first row.

    Raises:
        InputFileError: naming the first line.
    """
    for name, kind in columns.items():
        if kind is int:
            empty = table[name].is_null().to_numpy()
            bounded.require_rows(shown(path), empty, f"an integer '{name}'", "nothing", first=first)


def column_vectors(table: pa.Table, names: tuple[str, ...]) -> Float[np.ndarray, "n k"]:
    """Return some number columns side by side."""
    return np.column_stack([table[name].to_numpy() for name in names])


def require_increasing(
    path: Source, times: Int[np.ndarray, " n"], *, unit: str, place: str = "line", first: int = 2, remedy: str = _SORT
) -> None:
    """Refuse a clock that stands still or runs backwards.

    Args:
        path: The file, for the message.
        times: One time a row.
        unit: Their unit, for the message.
        place: What a row is called.
        first: Number of the first row.
        remedy: What to do about it, for the message.

    Raises:
        InputFileError: naming the first row that does not come after the one before it.
    """
    bounded.require_rows(
        shown(path),
        np.diff(times) <= 0,
        lambda row: f"a time after {times[row]} {unit}",
        lambda row: f"{times[row + 1]} {unit}",
        place=place,
        first=first + 1,
        remedy=remedy,
    )


def require_poses(
    path: Source, position: Points, rotation: Rotations, *, used: Bool[np.ndarray, " n"] | None = None, first: int = 2
) -> None:
    """Refuse poses that are no numbers or no rotations.

    Args:
        path: The file, for the message.
        position: One row a line.
        rotation: Quaternions in any order.
        used: Rows that matter; all by default.
        first: Line of the first row.

    Raises:
        InputFileError: naming the first bad line.
    """
    matters = np.ones(len(position), dtype=bool) if used is None else used
    bad = matters & ~np.isfinite(np.einsum("nk->n", position) + np.einsum("nk->n", rotation))
    remedy = "Remove the row, or download the file again."
    bounded.require_rows(shown(path), bad, "a pose of finite numbers", "NaN or nothing", first=first, remedy=remedy)
    length = np.sqrt(np.einsum("nk,nk->n", rotation, rotation))
    bounded.require_rows(
        shown(path),
        matters & (np.abs(length - 1) > _QUATERNION_TOLERANCE),
        "a quaternion of length 1",
        lambda row: f"length {length[row]:.4f}",
        first=first,
        remedy=_COPY_AGAIN,
    )


_GOT = re.compile(r"Expected (.+), got (\S+)")  # msgspec's words for a value of another kind
_NO_NUMBER = re.compile(rb"(?<=[\[,:\s])-?(?:NaN|Infinity)\b")


@bounded.foreign_input()
def decode_json(path: Source, form: type[Decoded], *, strict: bool = True) -> Decoded:
    """Read a JSON file into a data class; keys that the class does not name are skipped unread.

    A bare ``NaN`` or ``Infinity``, which is no JSON but is written by some programs, counts as ``null``.

    Args:
        path: The file.
        form: The class.
        strict: Whether a text that holds a number is refused where a number is expected.

    Raises:
        InputFileError: if the file is missing, is no JSON, or lacks a key (naming it).
    """
    try:
        # Some programs begin a file with a byte-order mark, which JSON does not know.
        content = read_all(path, largest=limits.LARGEST_JSON).removeprefix(b"\xef\xbb\xbf")
        try:
            return msgspec.json.decode(content, type=form, strict=strict)
        except msgspec.DecodeError:
            return msgspec.json.decode(_NO_NUMBER.sub(b"null", content), type=form, strict=strict)
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except msgspec.ValidationError as error:
        expected, remedy = "the keys of this format", "Is this the right file?"
        raise InputFileError(shown(path), "", expected=expected, found=str(error), remedy=remedy) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(shown(path), "", expected="valid JSON", found=str(error), remedy=_COPY_AGAIN) from error


def read_entries(
    path: Path, entries: Mapping[str, Encoded], decode: Callable[[Encoded], Decoded], expected: str = ""
) -> tuple[dict[str, Decoded], list[UnreadableEntry]]:
    """Decode the entries of an annotation file one by one, so that an odd one never loses its neighbours.

    Args:
        path: The file, for the record of what is left out.
        entries: What stands under each key, still undecoded.
        decode: Decodes one, or raises an error of msgspec, a ``ValueError`` or an ``InputFileError``.
        expected: The form of an entry in words, where the error does not tell it.

    Returns:
        The entries of this form in their order, and one record for each other.
    """
    readable = {}
    unreadable = []
    for key, raw in entries.items():
        try:
            readable[key] = decode(raw)
        except InputFileError as error:
            unreadable.append(UnreadableEntry(path.name, key, error.expected, error.found))
        except ValueError as error:  # those of msgspec are such, too
            found = _GOT.sub(r"\2 instead of \1", str(error)).replace(" - at ", " at ")
            unreadable.append(UnreadableEntry(path.name, key, expected, found))
    return readable, unreadable


def told_together(unreadable: list[UnreadableEntry]) -> list[UnreadableEntry]:
    """Return one record for all unreadable samples of a stream: none of them stands for an event."""
    if len(unreadable) < 2:
        return unreadable
    return [dataclasses.replace(unreadable[0], key=f"{unreadable[0].key} and {len(unreadable) - 1} more")]


@contextlib.contextmanager
def must_exist(path: Source) -> Iterator[None]:
    """Turn Python's error for a missing file into ours.

    Raises:
        InputFileError: if the block finds no file.
    """
    try:
        yield
    except FileNotFoundError as error:
        raise missing_file(path) from error


def missing_file(path: Source) -> InputFileError:
    """Return the error for a required file that is not there."""
    remedy = "Download the recording again."
    return InputFileError(shown(path), "", expected="this file", found="no such file", remedy=remedy)


def read_triangles(path: Path, *, expected: str = "a mesh of triangles", remedy: str = "") -> Triangles:
    """Read a mesh (.obj, .ply, .glb) in the coordinates and unit of its file.

    Transforms of its nodes are applied, materials are left aside, and no file that it names is opened.

    Args:
        path: The mesh.
        expected: What the file should be, for messages.
        remedy: What to do about a broken one.

    Raises:
        InputFileError: if the file is missing or holds no triangles.
    """
    import trimesh  # takes a third of a second, and only meshes need it

    kind = path.suffix.lower()[1:]
    try:
        content = bounded.read_whole(path)
        if kind == "glb":
            # Refuse arrays that declare more entries than the file has bytes, before the parser makes room for them.
            description = msgspec.json.decode(content[20 : 20 + int.from_bytes(content[12:16], "little")])
            largest = max((accessor["count"] for accessor in description.get("accessors", ())), default=0)
            entries = f"at most {len(content):,} entries, one a byte of the file"
            bounded.require(path, (largest <= len(content), "accessors", entries, f"{largest:,}", remedy))
        mesh = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False, skip_materials=True).to_mesh()
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        triangles = np.asarray(mesh.faces, dtype=np.int64)
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except (InputFileError, MemoryError):
        raise
    except Exception as error:  # whatever a broken file makes the parser stumble over, the user needs its name
        found = f"{type(error).__name__}: {str(error)[:120]}"
        raise InputFileError(path, "", expected=expected, found=found, remedy=remedy) from error
    if len(triangles) == 0 or not np.isfinite(vertices).all():
        found = f"{len(triangles)} triangles and {len(vertices)} corners"
        raise InputFileError(path, "", expected="triangles with finite corners", found=found, remedy=remedy)
    return vertices, triangles


@bounded.foreign_input()
def read_header(path: Source) -> list[str]:
    """Read the column names of a CSV file.

    Raises:
        InputFileError: if the file is missing, is no text, or its first line is too long.
    """
    try:
        with opened(path) as file:
            line = file.readline(limits.LONGEST_LINE + 1)
        if len(line) > limits.LONGEST_LINE:
            raise bounded.too_long_line(shown(path), "header")
        return header_names(line)
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except UnicodeDecodeError as error:
        expected = "text with comma-separated values"
        raise InputFileError(shown(path), "", expected=expected, found="other bytes") from error


def header_names(line: bytes) -> list[str]:
    """Return the column names in a header line.

    Raises:
        UnicodeDecodeError: if it is no text.
    """
    return [name.strip().strip('"') for name in line.decode("utf-8-sig").rstrip("\r\n").split(",")]


def read_lines(path: Path, columns: Iterable[str], remedy: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Read a CSV file that people write line by line.

    Returns:
        Its header, and its further lines that hold anything, with their numbers.

    Raises:
        InputFileError: if it is missing, is no text, or lacks one of the columns; ``remedy`` says what to do then.
    """
    try:
        reader = csv.reader(io.StringIO(read_text(path, largest=limits.HARMLESS_SIZE)))
        lines = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except csv.Error as error:
        raise InputFileError(path, "", expected="text with comma-separated values", found=str(error)) from error
    lines = [(number, cells) for number, cells in lines if any(cells)]
    header = lines[0][1] if lines else []
    found = f"the columns {', '.join(cell or '(unnamed)' for cell in header) or '(none)'}"
    bounded.require(path, *((name in header, "header", f"a column '{name}'", found, remedy) for name in columns))
    return header, lines[1:]


def write_table(file: Any, table: pa.Table) -> None:
    """Write a table as Project Aria's files have it: a plain header, and no quotes, which Arrow would put around it."""
    file.write((",".join(table.column_names) + "\n").encode())
    options = pyarrow.csv.WriteOptions(include_header=False, quoting_style="none", batch_size=65536)
    pyarrow.csv.write_csv(table, pa.PythonFile(file, mode="w"), options)
