"""Reads motions from files of any form, right or wrong, so that they can be diagnosed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.errors import InputFileError
from prbench.files.arrays import Archive, ArrayHeader, map_array, read_header, read_parquet
from prbench.files.bounded import foreign_input, open_regular
from prbench.geometry.skeleton import N_JOINTS

_LARGEST = 8 * 1024**3  # bytes of one array
_IDS = ("sequence_id", "opaque_id")
_FORMS = "an .npy or .npz file, Parquet, a folder of .npy or Parquet files, or a run folder"
_POSE_SIZE = N_JOINTS * 3


@dataclass(frozen=True)
class NamedMotion:
    """A motion and its name."""

    name: str
    """Sequence id, opaque id, number or the file's name."""
    sample: int
    values: np.ndarray
    """The array, of any shape."""


@dataclass(frozen=True)
class _MotionsRead:
    """The motions of a file, or some of them."""

    motions: tuple[NamedMotion, ...]
    total: int
    """All motions there are; ``motions`` holds fewer if a limit was given."""


@foreign_input()
def read_motions(path: Path, *, limit: int | None = None) -> _MotionsRead:
    """Read motions without asking that they be right.

    Args:
        path: A file or a folder of the forms above.
        limit: At most so many, spread evenly.

    Raises:
        InputFileError: if nothing there can be read as numbers.
    """
    if not path.exists():
        raise InputFileError(path, "", expected=_FORMS, found="no such file")
    motions = list(_from_folder(path) if path.is_dir() else _from_file(path))
    if not motions:
        raise InputFileError(path, "", expected="motions", found="none")
    # Evenly spread: the first motions of a file are often those of one recording.
    count = min(len(motions), limit or len(motions))
    chosen = [motions[place] for place in np.linspace(0, len(motions) - 1, count).round().astype(int)]
    return _MotionsRead(tuple(chosen), len(motions))


def _from_folder(path: Path) -> Iterator[NamedMotion]:
    runs = [folder for folder in (path, *sorted(path.iterdir())) if (folder / "predictions").is_dir()]
    places = [folder / "predictions" for folder in runs] or [path / "motions" if (path / "motions").is_dir() else path]
    for place in places:
        for file in sorted(place.iterdir()):
            if file.suffix in (".npy", ".parquet") and file.name[0] != ".":
                yield from _from_file(file)


def _from_file(path: Path) -> Iterator[NamedMotion]:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        yield from _unbatched(path.stem, _npy(path))
    elif suffix == ".npz":
        yield from _npz(path)
    elif suffix in (".parquet", ".pq"):
        yield from _parquet(path)
    else:
        remedy = "Save the joints with np.save: pickles (.pkl, .pt, .pth) are never opened, they can run programs."
        raise InputFileError(path, "", expected=_FORMS, found=f"a file named *{suffix}", remedy=remedy)


def _npy(path: Path) -> np.ndarray:
    with open_regular(path) as stream:
        header = read_header(stream, path, "")
    return _numbers(map_array(path, header), path, "")


def _numbers(values: np.ndarray, path: Path, where: str) -> np.ndarray:
    if values.dtype.kind not in "fiu":
        raise InputFileError(path, where, expected="numbers", found=str(values.dtype))
    return values


def _unbatched(name: str, values: np.ndarray) -> Iterator[NamedMotion]:
    """Split an array with a batch axis into one motion for each row, without the zeros or NaN behind its last frame."""
    if values.ndim < 4 or values.shape[0] == 1 or values.shape[1] == 1:
        yield NamedMotion(name, 0, values)
        return
    for row, motion in enumerate(values):
        yield NamedMotion(f"{name}[{row}]", 0, _without_padding(motion))


def _without_padding(motion: np.ndarray) -> np.ndarray:
    flat = np.nan_to_num(motion.reshape(len(motion), -1))
    written = np.flatnonzero(np.any(flat != 0, axis=1))
    return motion[: written[-1] + 1] if written.size else motion


def _npz(path: Path) -> Iterator[NamedMotion]:
    archive = Archive(path)
    headers = archive.headers()
    names = [name for name, header in headers.items() if header.dtype.kind in "fiu" and len(header.shape) >= 2]
    if "joints" in headers:
        yield from _npz_columns(archive)
        return
    if "noise_seed" in headers:
        raise InputFileError(
            path,
            "",
            expected="an array 'joints' with motions",
            found="the conditions that motions are to be made from",
            remedy="Give the file of motions here, and this one with --conditions.",
        )
    if not names:
        found = ", ".join(f"{name} {header.shape}" for name, header in headers.items()) or "nothing"
        raise InputFileError(path, "", expected="arrays of two axes or more", found=found)
    for name in _motion_like(headers, names):
        values = archive.read(name, largest=_LARGEST)
        if values.ndim == 4 and values.shape[2:] == (N_JOINTS, 3):
            yield from (NamedMotion(name, sample, motion) for sample, motion in enumerate(values))
        else:
            yield from _unbatched(name, values)


def _motion_like(headers: dict[str, ArrayHeader], names: list[str]) -> list[str]:
    """Choose the arrays with 22 joints, else the poses of a body's parameters, else all."""
    joints = [name for name in names if len(headers[name].shape) > 2 and headers[name].shape[-2:] == (N_JOINTS, 3)]
    return joints or [name for name in names if name == "poses"] or names


def _npz_columns(archive: Archive) -> Iterator[NamedMotion]:
    """Read one array ``joints`` beside ids and lengths, padded or one motion after another."""
    joints = _numbers(archive.read("joints", largest=_LARGEST), archive.path, "'joints'")
    columns = {name: archive.read(name, largest=_LARGEST) for name in archive.members if name != "joints"}
    lengths = columns.get("n_frames")
    id_name = next((name for name in _IDS if name in columns), None)
    ids = [str(name) for name in np.atleast_1d(columns[id_name])] if id_name else None
    if ids is None and lengths is None:
        yield from _unbatched("joints", joints)
        return
    rows = _rows(joints, lengths, len(ids) if ids is not None else None)
    names = ids if ids is not None and len(ids) == len(rows) else [f"joints[{row}]" for row in range(len(rows))]
    samples = np.atleast_1d(columns["sample"]) if "sample" in columns else np.zeros(len(rows), dtype=int)
    if len(samples) != len(rows):
        samples = np.zeros(len(rows), dtype=int)
    for name, sample, motion in zip(names, samples, rows, strict=True):
        yield NamedMotion(name, int(sample), motion)


def _rows(joints: np.ndarray, lengths: np.ndarray | None, n_ids: int | None) -> Sequence[np.ndarray]:
    if lengths is None:
        return list(joints) if len(joints) == n_ids else [joints]
    lengths = np.atleast_1d(lengths).astype(np.int64)
    if len(joints) == lengths.sum() and joints.ndim <= 3:
        return np.split(joints, np.cumsum(lengths)[:-1])
    if len(joints) == len(lengths):
        return [motion[: max(length, 0)] for motion, length in zip(joints, lengths, strict=True)]
    return [joints]


def _parquet(path: Path) -> Iterator[NamedMotion]:
    try:
        table = read_parquet(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputFileError(path, "", expected="a readable Parquet file", found=str(error).splitlines()[0]) from error
    if "joints" not in table.column_names:
        found = ", ".join(table.column_names)
        raise InputFileError(path, "", expected="a column 'joints'", found=found, remedy="Rename the column.")
    id_name = next((name for name in _IDS if name in table.column_names), None)
    names = table[id_name].to_pylist() if id_name else [f"row {row}" for row in range(table.num_rows)]
    samples = table["sample"].to_pylist() if "sample" in table.column_names else [0] * table.num_rows
    for row, (name, sample) in enumerate(zip(names, samples, strict=True)):
        yield NamedMotion(str(name), int(sample or 0), _frames(table["joints"][row], path, row))


def _frames(cell: pa.Scalar, path: Path, row: int) -> np.ndarray:
    """Return the frames of one row, however deeply their numbers are nested."""
    where = f"row {row}, column 'joints'"
    if not cell.is_valid or not pa.types.is_nested(cell.type):
        raise InputFileError(
            path, where, expected="a list of frames", found=str(cell.type) if cell.is_valid else "null"
        )
    values = cell.values
    count = len(cell.values)
    while pa.types.is_nested(values.type):
        if pa.types.is_struct(values.type) or pa.types.is_map(values.type):
            raise InputFileError(path, where, expected="lists of numbers", found=str(values.type))
        values = values.flatten()
    numbers = _numbers(values.to_numpy(zero_copy_only=False), path, where)
    if numbers.size == count and count % _POSE_SIZE == 0:
        count //= _POSE_SIZE  # one flat list
    if count == 0 or numbers.size % count:
        raise InputFileError(
            path, where, expected="frames of one size", found=f"{numbers.size} numbers in {count} frames"
        )
    frames = numbers.reshape(count, -1)
    return frames.reshape(count, N_JOINTS, 3) if frames.shape[1] == _POSE_SIZE else frames
