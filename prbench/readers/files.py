"""CSV and JSON files of native recordings: read by name, checked, refused with place and remedy."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.csv
from jaxtyping import Bool, Float, Int

from prbench.errors import InputFileError
from prbench.readers.last_line import require_whole_last_line

Column = type[int] | type[float] | type[str]
Decoded = TypeVar("Decoded")

_ARROW_TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string()}
_QUATERNION_TOLERANCE = 1e-3
_COPY_AGAIN = "The file may be truncated; copy or download it again."


def read_columns(path: Path, columns: Mapping[str, Column]) -> pa.Table:
    """Read the named columns of a CSV file; further columns and their order do not matter.

    Args:
        path: CSV with a header line.
        columns: Name and type of each column. Empty numbers become NaN; integers must not be empty.

    Raises:
        InputFileError: if the file or a column is missing, a line is cut, or a value is no number.
    """
    header = read_header(path)
    missing = [name for name in columns if name not in header]
    if missing:
        raise InputFileError(
            path,
            "header",
            expected=f"a column '{missing[0]}'",
            found=f"the columns {', '.join(header)}",
            remedy="This is another file, or another version of the format.",
        )
    types = {name: _ARROW_TYPES[kind] for name, kind in columns.items()}
    try:
        table = _parse(path, types, use_threads=True)
    except pa.ArrowInvalid:
        table = _parse_naming_row(path, types)
    require_whole_last_line(path, columns, header)
    for name, kind in columns.items():
        if kind is int and table[name].null_count:
            row = int(np.flatnonzero(table[name].is_null().to_numpy(zero_copy_only=False))[0])
            raise InputFileError(path, f"line {row + 2}", expected=f"an integer '{name}'", found="nothing")
    return table


def column_vectors(table: pa.Table, names: tuple[str, ...]) -> Float[np.ndarray, "n k"]:
    """Some number columns side by side."""
    return np.column_stack([table[name].to_numpy() for name in names])


def require_increasing(
    path: Path, times: Int[np.ndarray, " n"], *, unit: str, place: str = "line", first: int = 2
) -> None:
    """Refuse a clock that stands still or runs backwards.

    Args:
        path: The file, for the message.
        times: One time a row.
        unit: Their unit, for the message.
        place: What a row is called.
        first: Number of the first row.

    Raises:
        InputFileError: naming the first row that does not come after the one before it.
    """
    backwards = np.flatnonzero(np.diff(times) <= 0)
    if backwards.size:
        row = int(backwards[0]) + 1
        raise InputFileError(
            path,
            f"{place} {row + first}",
            expected=f"a time after {times[row - 1]} {unit}",
            found=f"{times[row]} {unit}",
            remedy="The clock runs backwards or a row is repeated; sort the rows by time and remove repeated ones.",
        )


def require_poses(
    path: Path,
    position: Float[np.ndarray, "n 3"],
    rotation: Float[np.ndarray, "n 4"],
    *,
    used: Bool[np.ndarray, " n"] | None = None,
) -> None:
    """Refuse poses that are no numbers or no rotations.

    Args:
        path: The file, for the message.
        position: One row a line.
        rotation: Quaternions in any order.
        used: Rows that matter; all by default.

    Raises:
        InputFileError: naming the first bad line.
    """
    matters = np.ones(len(position), dtype=bool) if used is None else used
    bad = matters & ~np.isfinite(np.einsum("nk->n", position) + np.einsum("nk->n", rotation))
    if bad.any():
        raise InputFileError(
            path,
            f"line {int(np.argmax(bad)) + 2}",
            expected="a pose of finite numbers",
            found="NaN or nothing",
            remedy="Remove the row, or download the file again.",
        )
    length = np.sqrt(np.einsum("nk,nk->n", rotation, rotation))
    bad = matters & (np.abs(length - 1) > _QUATERNION_TOLERANCE)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputFileError(
            path,
            f"line {row + 2}",
            expected="a quaternion of length 1",
            found=f"length {length[row]:.4f}",
            remedy=_COPY_AGAIN,
        )


def decode_json(path: Path, decoder: msgspec.json.Decoder[Decoded], *, nan_is_null: bool = False) -> Decoded:
    """Read a JSON file into a data class; keys that the class does not name are skipped unread.

    Args:
        path: The file.
        decoder: Knows the class.
        nan_is_null: Take a bare ``NaN``, which is no JSON but is written by some programs, for ``null``.

    Raises:
        InputFileError: if the file is missing, is no JSON, or lacks a key (naming it).
    """
    try:
        content = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
        if nan_is_null and b"NaN" in content:
            content = re.sub(rb"(?<=[\[,:\s])-?NaN\b", b"null", content)
        return decoder.decode(content)
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except msgspec.ValidationError as error:
        raise InputFileError(
            path,
            "",
            expected="the keys of this format",
            found=str(error),
            remedy="Is this the right file?",
        ) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise InputFileError(path, "", expected="valid JSON", found=str(error), remedy=_COPY_AGAIN) from error


def missing_file(path: Path) -> InputFileError:
    """The error for a required file that is not there."""
    return InputFileError(path, "", expected="this file", found="no such file", remedy="Download the recording again.")


def read_header(path: Path) -> list[str]:
    """Column names of a CSV file.

    Raises:
        InputFileError: if the file is missing or is no text.
    """
    try:
        with open(path, encoding="utf-8-sig") as file:
            return [name.strip().strip('"') for name in file.readline().rstrip("\r\n").split(",")]
    except FileNotFoundError as error:
        raise missing_file(path) from error
    except UnicodeDecodeError as error:
        raise InputFileError(path, "", expected="text with comma-separated values", found="other bytes") from error


def _parse(path: Path, types: Mapping[str, pa.DataType], *, use_threads: bool) -> pa.Table:
    return pyarrow.csv.read_csv(
        path,
        read_options=pyarrow.csv.ReadOptions(use_threads=use_threads),
        convert_options=pyarrow.csv.ConvertOptions(column_types=types, include_columns=list(types)),
    )


def _parse_naming_row(path: Path, types: Mapping[str, pa.DataType]) -> pa.Table:
    """Parse again in one thread, which is slow but knows the row of an error."""
    try:
        return _parse(path, types, use_threads=False)
    except pa.ArrowInvalid as error:
        found = str(error).splitlines()[0]
        row = re.search(r"Row #(\d+)", found)
        raise InputFileError(
            path,
            f"line {row[1]}" if row else "",
            expected="complete lines of comma-separated values of the right kind",
            found=f"'{found[:160]}'",
            remedy=_COPY_AGAIN,
        ) from error
