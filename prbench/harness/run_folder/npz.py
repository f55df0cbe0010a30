"""Predictions as ``.npz``: ids beside one array of all motions, or one array a sequence.

``joints`` is padded, (n, N, 22, 3), or holds the frames of all motions after one another, (total, 22, 3); in both
forms ``n_frames`` tells how many frames each has, and a pose may also be 66 numbers. Without ``joints`` and ids every
array is named by its sequence, (frames, 22, 3) or (samples, frames, 22, 3).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, PredictionsError
from prbench.files.arrays import Archive, ArrayHeader
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.scores import GAZE_COLUMNS
from prbench.limits import MOST_MOTIONS

POSE_SIZE = N_JOINTS * 3
_LARGEST_COLUMN = 1024**3  # bytes of ids or lengths, many times what any table needs
_LARGEST_ARRAY = 64 * 1024**3  # bytes of all motions
_PADDED_FRAMES = 1000  # to which any motion may be padded; wider arrays are refused before they are unpacked
_OPAQUE_ID = re.compile(r"[0-9a-f]{64}")
_FORMS = "(n, N, 22, 3) padded, or (total, 22, 3) after one another, of float32 or float64"


def as_float32(joints: np.ndarray) -> Float[np.ndarray, "..."]:
    """Return the numbers as a run keeps them, so that every way in scores alike; too large ones become infinite."""
    # Infinity is refused later, in words that name the sequence.
    with np.errstate(over="ignore"):
        return np.asarray(joints, dtype=np.float32)


def wrong_column(path: Path, name: str, expected: str, found: object, *, row: object = None) -> PredictionsError:
    """Return the error for an array, or for one of its rows, that is not what it should be."""
    place = "" if row is None else f", row {row}"
    return PredictionsError(f"{path}, '{name}'{place}: expected {expected}, found {found}.")


@dataclass(frozen=True, eq=False)
class ArrayMotions:
    """Motions in memory, each an array of its own.

    Attributes:
        places: File and place of each motion, for messages.
        rays: Gaze of each motion, (frames, 2, 3); empty for motions without gaze.
    """

    joints: tuple[np.ndarray, ...]
    places: tuple[str, ...]
    rays: tuple[np.ndarray, ...] = ()

    def motions(self, rows: Sequence[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Joints of some rows in the order given, and their gaze; no gaze where the motions bring none."""
        return [self.joints[row] for row in rows], [self.rays[row] for row in rows if self.rays]

    def where(self, row: int) -> str:
        """Return the file that a row stands in and its place there, for messages."""
        return self.places[row]

    def only(self, rows: Sequence[int]) -> ArrayMotions:
        """Return some of the motions, so that a worker is not sent all of them."""
        joints, rays = self.motions(rows)
        return ArrayMotions(tuple(joints), tuple(self.places[row] for row in rows), tuple(rays))


# The fields of :class:`~prbench.harness.run_folder.predictions.Predictions`, but for ``rows``.
Indexed = tuple[tuple[Path, ...], str, tuple[str, ...], tuple[int, ...], Any, bool]


def read_npz(path: Path) -> Indexed:
    """Read all motions, once what the headers say was checked.

    Raises:
        PredictionsError: if the file cannot be read, or arrays are missing, of a wrong kind or do not fit together.
    """
    try:
        return _read(Archive(path), path)
    except InputFileError as error:
        raise PredictionsError(str(error)) from error


def _read(archive: Archive, path: Path) -> Indexed:
    present = list(archive.members)
    id_column = next((name for name in ("sequence_id", "opaque_id") if name in present), None)
    if id_column is None and present and "joints" not in present:
        named = _read_by_name(archive, path)
        if named is not None:
            return named
    absent = [name for name in ("joints", "n_frames") if name not in present]
    if id_column is None or absent:
        itself = " These look like conditions, not motions." if "noise_seed" in present and "joints" in absent else ""
        raise PredictionsError(
            f"{path}: expected the arrays opaque_id (or sequence_id), joints and n_frames, found"
            f" {', '.join(sorted(present)[:10]) or 'none'}.{itself} Copy opaque_id, sample and n_frames from the"
            " conditions file."
        )
    # A header may announce any number of empty texts.
    announced = math.prod(archive.header(id_column).shape)
    if announced > MOST_MOTIONS:
        raise PredictionsError(f"{path}: expected at most {MOST_MOTIONS:,} motions, found {announced:,}.")
    ids = archive.read(id_column, largest=_LARGEST_COLUMN)
    if ids.ndim != 1 or ids.dtype.kind not in "US":
        raise wrong_column(path, id_column, "one text a motion", f"shape {ids.shape} of {ids.dtype}")
    ids = np.char.decode(ids, "utf-8") if ids.dtype.kind == "S" else ids
    whole = {"sample": np.zeros(len(ids), dtype=np.int64)}
    for name, smallest in (("n_frames", 1), ("sample", 0)):
        if name not in present:
            continue
        values = archive.read(name, largest=_LARGEST_COLUMN)
        if values.shape != (len(ids),) or values.dtype.kind not in "iu":
            found = f"shape {values.shape} of {values.dtype}"
            raise wrong_column(path, name, f"{len(ids)} whole numbers, one a motion", found)
        low = np.flatnonzero(values < smallest)
        if low.size:
            raise wrong_column(path, name, f"{smallest} or more", values[low[0]], row=low[0])
        whole[name] = values.astype(np.int64)
    n_frames = whole["n_frames"]
    frames = _frames_of(archive.header("joints"), path, n_frames)
    gaze = [name for name in GAZE_COLUMNS if name in present]
    if len(gaze) == 1:
        raise PredictionsError(f"{path}: expected both arrays {' and '.join(GAZE_COLUMNS)}, found {gaze[0]} alone.")
    for name in gaze:
        header = archive.header(name)
        if header.shape != (*frames, 3) or not _is_floating(header.dtype):
            expected = f"the shape {(*frames, 3)} of float32 or float64, as the joints have frames"
            raise wrong_column(path, name, expected, f"{header.shape} of {header.dtype}")

    def split(name: str, *shape: int) -> list[np.ndarray]:
        """Return the array's motions, one after the other."""
        values = archive.read(name, largest=_LARGEST_ARRAY).reshape(*frames, *shape)
        if len(frames) == 2:
            return [as_float32(motion[:n]) for motion, n in zip(values, n_frames, strict=True)]
        return [as_float32(motion) for motion in np.split(values, np.cumsum(n_frames)[:-1])] if len(n_frames) else []

    rays = zip(*(split(name, 3) for name in gaze), strict=True)
    store = ArrayMotions(
        tuple(split("joints", N_JOINTS, 3)),
        tuple(f"{path}, row {row}" for row in range(len(ids))),
        tuple(np.stack(pair, axis=1) for pair in rays),
    )
    return (path,), id_column, tuple(ids.tolist()), tuple(whole["sample"].tolist()), store, bool(gaze)


def _read_by_name(archive: Archive, path: Path) -> Indexed | None:
    """Read one array a sequence; None if some array has not the shape of motions."""
    headers = {name: archive.header(name) for name in archive.members}
    shapes = [header.shape for header in headers.values()]
    if not all(len(shape) in (3, 4) and shape[-2:] == (N_JOINTS, 3) for shape in shapes):
        return None
    if sum(shape[0] if len(shape) == 4 else 1 for shape in shapes) > MOST_MOTIONS:
        raise PredictionsError(f"{path}: expected at most {MOST_MOTIONS:,} motions.")
    keys: list[tuple[str, int]] = []
    motions: list[np.ndarray] = []
    for name, header in headers.items():
        if not _is_floating(header.dtype):
            raise wrong_column(path, name, "float32 or float64", header.dtype)
        values = as_float32(archive.read(name, largest=_LARGEST_ARRAY))
        for sample, motion in enumerate(values.reshape(-1, *header.shape[-3:])):
            keys.append((name, sample))
            motions.append(motion)
    ids = tuple(name for name, _ in keys)
    id_column = "opaque_id" if all(map(_OPAQUE_ID.fullmatch, ids)) else "sequence_id"
    store = ArrayMotions(tuple(motions), tuple(f"{path}, '{name}', sample {sample}" for name, sample in keys))
    return (path,), id_column, ids, tuple(sample for _, sample in keys), store, False


def _is_floating(dtype: np.dtype) -> bool:
    """Return True for the two types that coordinates may have in a file, float32 and float64."""
    return dtype.kind == "f" and dtype.itemsize in (4, 8)


def _frames_of(header: ArrayHeader, path: Path, n_frames: np.ndarray) -> tuple[int, ...]:
    """Return the axes of ``joints`` before those of a pose: (n, N) where it is padded, (total,) where it is not."""
    axes = len(header.shape)
    of_pose = 2 if header.shape[-2:] == (N_JOINTS, 3) else 1 if header.shape[-1:] == (POSE_SIZE,) else axes
    frames = header.shape[: axes - of_pose]
    if len(frames) not in (1, 2) or not _is_floating(header.dtype):
        raise wrong_column(path, "joints", _FORMS, f"{header.shape} of {header.dtype}")
    if len(frames) == 1:
        if frames[0] != n_frames.sum():
            raise wrong_column(path, "joints", f"{n_frames.sum()} frames, the sum of n_frames", frames[0])
        return frames
    if frames[0] != len(n_frames):
        raise wrong_column(path, "joints", f"{len(n_frames)} motions, one an id", frames[0])
    # Only the header has been read so far: a tiny file may announce terabytes of zeros.
    widest = max(_PADDED_FRAMES, 4 * int(n_frames.max(initial=0)))
    if frames[1] > widest:
        expected = f"at most {widest} frames, as n_frames needs {n_frames.max(initial=0)}"
        raise wrong_column(path, "joints", expected, f"{frames[1]}. Save joints[:, :n_frames.max()]")
    longer = np.flatnonzero(n_frames > frames[1])
    if longer.size:
        expected = f"{n_frames[longer[0]]} frames (n_frames)"
        raise wrong_column(path, "joints", expected, frames[1], row=longer[0])
    return frames
