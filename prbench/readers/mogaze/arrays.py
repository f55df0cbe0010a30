"""HDF5 files of MoGaze: arrays and attributes by name, checked, refused with place and remedy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError

_COPY_AGAIN = "The file may be truncated; copy or download it again."


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file, open for reading.

    Raises:
        InputFileError: if it cannot be opened, or a read inside fails.
    """
    try:
        with h5py.File(path, "r") as file:
            yield file
    except OSError as error:
        found = str(error).splitlines()[0]
        raise InputFileError(path, "", expected="a complete HDF5 file", found=found, remedy=_COPY_AGAIN) from error


def dataset(path: Path, parent: h5py.Group, name: str) -> h5py.Dataset:
    """One dataset of a file or group.

    Raises:
        InputFileError: if it is missing, listing what is there.
    """
    entry = parent.get(name)
    if isinstance(entry, h5py.Dataset):
        return entry
    raise InputFileError(
        path,
        parent.name or "",
        expected=f"a dataset '{name}'",
        found=", ".join(parent) or "nothing",
        remedy="Is this the right file?",
    )


def group(path: Path, file: h5py.File, name: str) -> h5py.Group:
    """One group of a file.

    Raises:
        InputFileError: if it is missing, listing what is there.
    """
    entry = file.get(name)
    if isinstance(entry, h5py.Group):
        return entry
    raise InputFileError(
        path, "", expected=f"a group '{name}'", found=", ".join(file) or "nothing", remedy="Is this the right file?"
    )


def numbers(path: Path, entry: h5py.Dataset, *, columns: int) -> Float[np.ndarray, "n columns"]:
    """A table of numbers with at least ``columns`` columns.

    Raises:
        InputFileError: if it is of another shape or kind.
    """
    if entry.ndim != 2 or entry.shape[1] < columns or entry.dtype.kind not in "fiu":
        raise InputFileError(
            path,
            entry.name or "",
            expected=f"rows of at least {columns} numbers",
            found=f"shape {entry.shape}, type {entry.dtype}",
            remedy="Is this the right file?",
        )
    return entry[...].astype(np.float64)


def attribute(path: Path, entry: h5py.Dataset, name: str) -> np.ndarray:
    """One attribute as an array.

    Raises:
        InputFileError: if it is missing, listing what is there.
    """
    if name not in entry.attrs:
        raise InputFileError(
            path,
            f"attributes of {entry.name}",
            expected=f"'{name}'",
            found=", ".join(entry.attrs) or "none",
            remedy="Copy or download the file again.",
        )
    return np.atleast_1d(np.asarray(entry.attrs[name]))


def words(values: np.ndarray | Sequence[object]) -> list[str]:
    """Texts, whether the file holds them as bytes (padded or not) or as strings."""
    return [
        value.decode("utf-8", "replace").rstrip("\0") if isinstance(value, bytes) else str(value) for value in values
    ]
