"""HDF5 files of MoGaze: arrays and attributes by name, checked, refused with place and remedy."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.bounded import require_size
from prbench.limits import HARMLESS_SIZE, HIGHEST_COMPRESSION, LARGEST_ARRAYS, LARGEST_UNPACKED

_SHOWN = 8
"""Names that a message lists."""
_COPY_AGAIN = "The file may be truncated; copy or download it again."


@contextmanager
def opened(path: Path) -> Iterator[h5py.File]:
    """An HDF5 file, open for reading.

    Raises:
        InputFileError: if it cannot be opened, or a read inside fails.
    """
    try:
        require_size(path, largest=LARGEST_UNPACKED)
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, RuntimeError) as error:  # h5py says the latter of damaged links and indices
        found = str(error).splitlines()[0]
        raise InputFileError(path, "", expected="a complete HDF5 file", found=found, remedy=_COPY_AGAIN) from error


def dataset(path: Path, parent: h5py.Group, name: str) -> h5py.Dataset:
    """One dataset of a file or group.

    Raises:
        InputFileError: if it is missing, listing what is there, or lies in another file.
    """
    entry = _entry(path, parent, name)
    if isinstance(entry, h5py.Dataset):
        return entry
    raise InputFileError(
        path,
        parent.name or "",
        expected=f"a dataset '{name}'",
        found=_names(parent),
        remedy="Is this the right file?",
    )


def group(path: Path, file: h5py.File, name: str) -> h5py.Group:
    """One group of a file.

    Raises:
        InputFileError: if it is missing, listing what is there, or lies in another file.
    """
    entry = _entry(path, file, name)
    if isinstance(entry, h5py.Group):
        return entry
    raise InputFileError(path, "", expected=f"a group '{name}'", found=_names(file), remedy="Is this the right file?")


def _entry(path: Path, parent: h5py.Group, name: str) -> object:
    """Return what stands under a name in this very file; a link that leads elsewhere is never followed."""
    link = parent.get(name, getlink=True)
    if link is not None and not isinstance(link, h5py.HardLink):
        found = f"a link ({type(link).__name__})"
        raise InputFileError(path, f"{parent.name}, '{name}'", expected="numbers in this file", found=found)
    return parent.get(name)


def _names(parent: h5py.Group) -> str:
    return ", ".join(itertools.islice(parent, _SHOWN)) + (" …" if len(parent) > _SHOWN else "") or "nothing"


def stored_values(path: Path, entry: h5py.Dataset) -> np.ndarray:
    """All values of a dataset; what it declares is held against what is stored before anything is allocated.

    Raises:
        InputFileError: if it declares more than its stored bytes can hold, or its values lie in other files.
    """
    if entry.external or entry.is_virtual:
        raise InputFileError(path, entry.name or "", expected="values in this file", found="values in other files")
    stored = entry.id.get_storage_size()
    largest = min(LARGEST_ARRAYS, max(HARMLESS_SIZE, HIGHEST_COMPRESSION * stored))
    at_once = max(math.prod(shape) for shape in (entry.shape or (), entry.chunks or ()))
    if at_once * entry.dtype.itemsize > largest:
        raise InputFileError(
            path,
            entry.name or "",
            expected=f"at most {largest:,} bytes of values, for {stored:,} that are stored",
            found=f"shape {entry.shape} of {entry.dtype}",
            remedy=_COPY_AGAIN,
        )
    return entry[...]


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
    return stored_values(path, entry).astype(np.float64)


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
            found=", ".join(itertools.islice(entry.attrs, _SHOWN)) or "none",
            remedy="Copy or download the file again.",
        )
    stored = entry.attrs.get_id(name)
    if stored.shape is None:
        raise InputFileError(path, f"attribute '{name}'", expected="values", found="none", remedy=_COPY_AGAIN)
    if math.prod(stored.shape or ()) * stored.dtype.itemsize > HARMLESS_SIZE:
        found = f"shape {stored.shape}"
        raise InputFileError(path, f"attribute '{name}'", expected=f"at most {HARMLESS_SIZE:,} bytes", found=found)
    return np.atleast_1d(np.asarray(entry.attrs[name]))


def number_attribute(path: Path, entry: h5py.Dataset, name: str) -> Float[np.ndarray, "..."]:
    """One attribute as numbers.

    Raises:
        InputFileError: see :func:`attribute`, or if it holds anything else.
    """
    found = attribute(path, entry, name)
    if found.dtype.kind not in "fiu":
        raise InputFileError(path, f"attribute '{name}'", expected="numbers", found=str(found.dtype))
    return found.astype(np.float64)


def words(values: np.ndarray | Sequence[object]) -> list[str]:
    """Texts, whether the file holds them as bytes (padded or not) or as strings."""
    return [
        value.decode("utf-8", "replace").rstrip("\0") if isinstance(value, bytes) else str(value) for value in values
    ]
