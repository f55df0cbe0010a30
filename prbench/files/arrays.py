"""NumPy's own files, read without trust: headers first, no pickles, nothing larger than what was announced.

``.npz`` is a ZIP archive of ``.npy`` members. A member that is stored as it is (``np.savez``) is mapped into memory, so
that single motions can be read from a file of any size; a compressed one (``np.savez_compressed``) has to be unpacked
as a whole.

Parquet files, opened without trust: what their metadata declares is looked at before a row is unpacked.

A few bytes of a Parquet file can stand for billions of equal values, so its size on the disk says nothing.

Numbers of recordings that cannot be what their fields mean, refused with stream, row and value; and repeated ids.
"""

from __future__ import annotations

import contextlib
import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float

from prbench import limits
from prbench.errors import InputFileError, RecordingUnusable
from prbench.files.bounded import open_regular, require, require_rows, require_size, require_unpackable
from prbench.limits import LARGEST_ARCHIVE, LARGEST_ARRAYS, LONGEST_AXIS  # by name: scaffold/one_file.py copies users

_PIECE = 4 * 1024**2
_SAVED = "an array as np.save writes it"
_NO_OBJECTS = "Save numbers and text only: np.array(values, dtype=np.float32), or np.array(names) without dtype=object."


@dataclass(frozen=True)
class ArrayHeader:
    """The header of a ``.npy``.

    Attributes:
        offset: Bytes before the values.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    fortran_order: bool
    offset: int

    @property
    def nbytes(self) -> int:
        """Bytes of the values."""
        return math.prod(self.shape) * self.dtype.itemsize

    def shaped(self, values: np.ndarray) -> np.ndarray:
        """Flat values as the array that was saved."""
        return values.reshape(self.shape, order="F" if self.fortran_order else "C")


def read_header(stream: IO[bytes], path: Path, where: str, *, remedy: str = "") -> ArrayHeader:
    """Read the header of a ``.npy``, up to its first value.

    Args:
        stream: The file, at its beginning.
        path: The file, for messages.
        where: The array in it, for messages.
        remedy: What to do if it is no ``.npy``, for messages.

    Raises:
        InputFileError: if it is no ``.npy``, or holds Python objects, which are never unpickled.
    """
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran_order, dtype = read(stream)
    except (ValueError, SyntaxError, TypeError, EOFError, tokenize.TokenError) as error:
        first = str(error).splitlines()[0][:100] if str(error) else type(error).__name__
        raise InputFileError(path, where, expected=_SAVED, found=first, remedy=remedy) from error
    is_array = all(0 <= size <= LONGEST_AXIS for size in shape) and dtype.itemsize > 0
    require(path, (not dtype.hasobject, where, "numbers or text", "Python objects", remedy or _NO_OBJECTS))
    require(path, (is_array, where, _SAVED, f"the shape {shape} of {dtype}", remedy))
    return ArrayHeader(shape, dtype, fortran_order, stream.tell())


def map_array(path: Path, header: ArrayHeader) -> np.ndarray:
    """Return the array of a ``.npy`` as a read-only view of its file.

    Raises:
        InputFileError: if the file ends too early.
    """
    if not header.nbytes:
        return np.empty(header.shape, header.dtype)
    size = require_size(path, largest=LARGEST_ARCHIVE)
    end = header.offset + header.nbytes
    require(path, (size >= end, "", f"{end} bytes", size, "It is cut off; write it again."))
    order = "F" if header.fortran_order else "C"
    return np.memmap(path, header.dtype, mode="r", offset=header.offset, shape=header.shape, order=order)


def load_array(path: Path, *, largest: int = LARGEST_ARRAYS, remedy: str = "") -> np.ndarray:
    """Return a whole ``.npy``; nothing is allocated before its header agrees with the size of the file.

    Args:
        path: The file.
        largest: Bytes beyond which it is refused unread.
        remedy: What to do if it is damaged or another file, for messages.

    Raises:
        InputFileError: if it is missing, too large, cut off, no ``.npy``, or holds Python objects.
    """
    try:
        with open_regular(path, largest=largest) as file:
            header = read_header(file, path, "", remedy=remedy)
            present = max(path.stat().st_size - header.offset, 0)
            form = f"(shape {header.shape} of {header.dtype})"
            cut = "The file is cut off; write it again."
            declared = f"{header.nbytes:,}"
            require(
                path,
                (header.nbytes <= largest, "", f"at most {largest:,} bytes", f"{declared} declared {form}", ""),
                (header.nbytes <= present, "", f"{declared} bytes {form}", f"{present:,}", cut),
            )
            return header.shaped(_values(file, header))
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="this file", found="no such file", remedy=remedy) from error


def _values(stream: IO[bytes], header: ArrayHeader) -> np.ndarray:
    """Return the values behind a header, flat, in memory of their own."""
    values = bytearray(header.nbytes)
    filled = 0
    while filled < header.nbytes and (part := stream.read(min(_PIECE, header.nbytes - filled))):
        values[filled : filled + len(part)] = part
        filled += len(part)
    return np.frombuffer(values, header.dtype) if values else np.empty(header.shape, header.dtype).ravel()


@dataclass(frozen=True)
class Archive:
    """An ``.npz``; arrays are read when they are asked for.

    Attributes:
        remedy: Advice for messages if it is damaged or another file.
    """

    path: Path
    remedy: str = ""

    @cached_property
    def members(self) -> dict[str, zipfile.ZipInfo]:
        """Maps each array's name to the array.

        Raises:
            InputFileError: if the file is missing or no ZIP archive, or holds an array twice.
        """
        found: dict[str, zipfile.ZipInfo] = {}
        with self._opened() as archive:
            for info in archive.infolist():
                name = info.filename.removesuffix(".npy")
                require(self.path, (name not in found, f"'{name}'", "an array once", "it again", ""))
                found[name] = info
        return found

    def require(self, names: Iterable[str]) -> None:
        """Refuse an archive that lacks an array.

        Raises:
            InputFileError: naming the first one, and those that are there.
        """
        found = ", ".join(sorted(self.members)) or "nothing"
        require(self.path, *((name in self.members, "", f"an array '{name}'", found, self.remedy) for name in names))

    def load(self, names: Iterable[str], *, largest: int = LARGEST_ARRAYS) -> dict[str, np.ndarray]:
        """Those of some arrays that are there, whole and writable; their declared sizes are looked at first.

        Args:
            names: Names of the arrays.
            largest: Bytes of all of them beyond which none is unpacked.

        Raises:
            InputFileError: if they are too large, damaged, or hold Python objects.
        """
        present = {name: self.members[name] for name in names if name in self.members}
        declared = sum(info.file_size for info in present.values())
        expected = f"arrays of at most {largest:,} bytes"
        require(self.path, (declared <= largest, "", expected, f"{declared:,} declared", ""))
        arrays = {}
        with self._opened() as archive:
            for name, info in present.items():
                require_unpackable(self.path, info, where=f"'{name}'")
                with archive.open(info) as stream:
                    header = self._header(name, stream)
                    arrays[name] = header.shaped(_values(stream, header))
        return arrays

    def header(self, name: str) -> ArrayHeader:
        """Shape and kind of an array; its values are not read.

        Raises:
            InputFileError: see :func:`read_header`; also if the member is not as long as its header says.
        """
        with self._opened() as archive, archive.open(self.members[name]) as stream:
            return self._header(name, stream)

    def read(self, name: str, *, largest: int) -> np.ndarray:
        """Return a whole array.

        Args:
            name: Name of the array.
            largest: Bytes beyond which it is refused unread.

        Raises:
            InputFileError: if it is larger, damaged, or holds Python objects.
        """
        header = self.header(name)
        require_unpackable(self.path, self.members[name], where=f"'{name}'")
        found = f"{header.nbytes:,} (shape {header.shape} of {header.dtype})"
        require(self.path, (header.nbytes <= largest, f"'{name}'", f"at most {largest:,} bytes", found, ""))
        return self.load([name], largest=self.members[name].file_size)[name]

    def blocks(self, name: str, rows: int) -> Iterator[np.ndarray]:
        """Yield an array in blocks of so many rows, the last one shorter; no more than one is in memory.

        Raises:
            InputFileError: see :meth:`read`; also if the array was saved column by column.
        """
        require_unpackable(self.path, self.members[name], where=f"'{name}'")
        with self._opened() as archive, archive.open(self.members[name]) as stream:
            header = self._header(name, stream)
            require(self.path, (not header.fortran_order, f"'{name}'", "rows one after the other", "columns", ""))
            each = math.prod(header.shape[1:])
            for first in range(0, header.shape[0], rows):
                shape = (min(rows, header.shape[0] - first), *header.shape[1:])
                values = stream.read(shape[0] * each * header.dtype.itemsize)
                yield np.frombuffer(values, header.dtype).reshape(shape)

    def _header(self, name: str, stream: IO[bytes]) -> ArrayHeader:
        header = read_header(stream, self.path, f"'{name}'", remedy=self.remedy)
        size = self.members[name].file_size
        announced = header.offset + header.nbytes
        expected = f"{announced:,} bytes (shape {header.shape} of {header.dtype})"
        remedy = "The file is damaged; write it again."
        require(self.path, (announced == size, f"'{name}'", expected, f"{size:,}", remedy))
        return header

    @contextlib.contextmanager
    def _opened(self) -> Iterator[zipfile.ZipFile]:
        """Yield the archive; what is wrong with its bytes becomes an error that names it."""
        try:
            with open_regular(self.path) as file, zipfile.ZipFile(file) as archive:
                yield archive
        except FileNotFoundError as error:
            raise InputFileError(self.path, "", expected="an .npz file", found="no file", remedy=self.remedy) from error
        except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, OSError, ValueError) as error:
            found = f"another form or a damaged one ({str(error) or type(error).__name__})"
            remedy = self.remedy or "Write it with np.savez or np.savez_compressed."
            raise InputFileError(self.path, "", expected="a readable .npz file", found=found, remedy=remedy) from error


def open_parquet(path: Path, *, verify: bool = False) -> pq.ParquetFile:
    """Return a Parquet file whose metadata declares no more than a table or a run can hold.

    Args:
        path: The file.
        verify: Compare the checksum of every page that is read.

    Raises:
        InputFileError: if it is a folder, a pipe or a device.
        pa.ArrowInvalid: if it is no Parquet file, or declares too much.
        OSError: if it is missing or cannot be read.
    """
    require_size(path, largest=limits.LARGEST_ARCHIVE)
    file = pq.ParquetFile(
        path,
        page_checksum_verification=verify,
        thrift_string_size_limit=limits.LARGEST_HEADER,
        # Reading ahead keeps every row group that was streamed in memory until the file is closed.
        pre_buffer=False,
    )
    metadata = file.metadata
    twice = first_repeated(file.schema_arrow.names)
    if twice is not None:
        raise pa.ArrowInvalid(f"the column '{twice}' is there twice; which one is meant nobody can tell")
    if metadata.num_rows > limits.MOST_ROWS:
        raise pa.ArrowInvalid(f"{metadata.num_rows:,} rows declared, expected at most {limits.MOST_ROWS:,}")
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for column in map(group.column, range(group.num_columns)):
            plausible = max(limits.MOST_VALUES, limits.MOST_VALUES_PER_BYTE * column.total_compressed_size)
            if column.num_values > plausible:
                raise pa.ArrowInvalid(
                    f"{column.num_values:,} values of '{column.path_in_schema}' declared in row group {number},"
                    f" expected at most {plausible:,} in {column.total_compressed_size:,} bytes"
                )
    return file


def read_parquet(path: Path, columns: list[str] | None = None, *, verify: bool = False) -> pa.Table:
    """Return some columns of a Parquet file, all by default (see :func:`open_parquet` for what it raises)."""
    file = open_parquet(path, verify=verify)
    missing = [name for name in columns or () if name not in file.schema_arrow.names]
    if missing:
        raise pa.ArrowInvalid(f"no column '{missing[0]}'")
    return file.read(columns)


_REMEDY = "A number of its files is damaged, or in another unit; compare them with another copy."
_LENGTH_TOLERANCE = 0.01


def require_times(stream: str, times: Float[np.ndarray, " n"]) -> None:
    """Refuse clocks that no recording has.

    Args:
        stream: What the times are of, for the message.
        times: Seconds.

    Raises:
        RecordingUnusable: naming the first row beyond :data:`prbench.limits.LATEST_TIME`, or the two ends of a stream
            that is longer than :data:`prbench.limits.LONGEST_RECORDING`.
    """
    beyond = np.abs(times) > limits.LATEST_TIME
    if beyond.any():
        row = int(np.argmax(beyond))
        raise _unusable(stream, row, f"a time within {limits.LATEST_TIME:.0e} s", f"{times[row]:g} s")
    if len(times) and np.ptp(times) > limits.LONGEST_RECORDING:
        problem = f"expected at most {limits.LONGEST_RECORDING:,.0f} s from first to last,"
        found = f"found {times.min():.1f} … {times.max():.1f} s. {_REMEDY}"
        raise RecordingUnusable(f"{stream}: {problem} {found}")


def require_near(
    stream: str, points: Float[np.ndarray, "n ..."], valid: Bool[np.ndarray, " n"] | None = None, *, farthest: float
) -> None:
    """Refuse points that lie farther from the origin than anything can.

    Args:
        stream: What the points are of, for the message.
        points: One or more points a row, metres.
        valid: Rows that matter; all by default.
        farthest: Largest coordinate, metres.

    Raises:
        RecordingUnusable: naming the first such row and its value.
    """
    if points.size == 0:
        return
    beyond = np.abs(points.reshape(len(points), -1)) > farthest
    if valid is not None:
        beyond &= valid[:, None]
    if beyond.any():
        row = int(np.argmax(beyond.any(axis=1)))
        found = points[row].reshape(-1)[int(np.argmax(beyond[row]))]
        raise _unusable(stream, row, f"a position within {farthest:,.0f} m of the origin", f"{found:g} m")


def require_unit_length(stream: str, vectors: Float[np.ndarray, "n k"], valid: Bool[np.ndarray, " n"]) -> None:
    """Refuse directions and quaternions whose length is not 1.

    Raises:
        RecordingUnusable: naming the first such row and its length.
    """
    length = np.sqrt(np.einsum("nk,nk->n", vectors, vectors, dtype=np.float64))
    wrong = valid & (np.abs(length - 1) > _LENGTH_TOLERANCE)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise _unusable(stream, row, "a vector of length 1", f"length {length[row]:g}")


def require_column(
    path: Path | str, column: str, values: Float[np.ndarray, " n"], *, largest: float, unit: str, remedy: str = _REMEDY
) -> None:
    """Refuse a column of a table file that holds a number beyond what its field can mean; NaN may stand in it.

    Args:
        path: The file, whose first row of numbers is its second line.
        column: Name of the column.
        values: Its numbers.
        largest: Largest number without sign.
        unit: Unit of the numbers, for the message.
        remedy: What to do about a larger one.

    Raises:
        InputFileError: naming line and column of the first such number.
    """
    expected = f"a number within {largest:g} {unit}"
    bad = np.abs(values) > largest
    require_rows(path, bad, expected, lambda row: f"{values[row]:g}", column=column, remedy=remedy)


def first_repeated(ids: Iterable[str]) -> str | None:
    """Return the first id that has stood before, or None if all are different."""
    seen = set[str]()
    for name in ids:
        if name in seen:
            return name
        seen.add(name)
    return None


def _unusable(stream: str, row: int, expected: str, found: str) -> RecordingUnusable:
    return RecordingUnusable(f"{stream}, row {row}: expected {expected}, found {found}. {_REMEDY}")
