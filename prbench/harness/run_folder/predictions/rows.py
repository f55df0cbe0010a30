"""Motions after one another, and what reads them from a file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pyarrow as pa
from jaxtyping import Float, Int

from prbench.errors import InputFileError, PredictionsError
from prbench.files.arrays import read_parquet
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.scores import GAZE_COLUMNS, predictions_schema
from prbench.sequences.write import write_table

POSE_SIZE = N_JOINTS * 3


@dataclass(frozen=True)
class PredictionRows:
    """Motions of some sequences after one another."""

    values: Float[np.ndarray, "total joints 3"]
    """Metres, in the frame of the question; 22 joints in a canonical frame for prime-and-reach."""
    offsets: Int[np.ndarray, " offsets"]
    """Row at which each motion begins, then the number of all frames."""
    gaze: Float[np.ndarray, "total 2 3"] | None = None
    """Middle between the eyes (metres) and unit direction of the gaze in each frame; None for motions without gaze."""

    @classmethod
    def from_padded(
        cls,
        joints: Float[np.ndarray, "batch frames joints 3"],
        n_frames: Int[np.ndarray, " batch"],
        gaze: Float[np.ndarray, "batch frames 2 3"] | None = None,
    ) -> PredictionRows:
        """Leave out what stands behind the last frame of each row."""
        valid = np.arange(joints.shape[1]) < n_frames[:, None]
        offsets = np.concatenate(([0], np.cumsum(n_frames)))
        return cls(joints[valid], offsets, None if gaze is None else gaze[valid])


@runtime_checkable
class MotionStore(Protocol):
    """Reads single motions. Goes to worker processes, so it holds paths, not open files."""

    def make_ready(self, together: Iterable[Sequence[int]] = ()) -> None:
        """Do once what every process would have to do: call it before the store goes to others.

        Args:
            together: Rows that will be asked for together, as far as that is known.
        """
        ...

    def motions(self, rows: Sequence[int]) -> list[Float[np.ndarray, "_ 22 3"]]:
        """The motions of some rows, in the order given."""
        ...

    def gaze(self, rows: Sequence[int]) -> list[Float[np.ndarray, "_ 2 3"]]:
        """The gaze of some rows, in the order given; asked for only where the file has gaze."""
        ...

    def where(self, row: int) -> str:
        """The file that a row stands in and its place there, for messages."""
        ...


@dataclass(frozen=True)
class IndexedRows:
    """Contents of a predictions file, known without reading a motion."""

    paths: tuple[Path, ...]
    id_column: str
    """``sequence_id`` or ``opaque_id``."""
    ids: tuple[str, ...]
    """Id of every motion, in the order of the files."""
    samples: tuple[int, ...]
    n_frames: Int[np.ndarray, " n"] | None
    """Length of every motion; None where only the motions themselves tell (Parquet)."""
    store: MotionStore
    has_gaze: bool = False
    """True if every motion comes with gaze."""


@dataclass(frozen=True)
class Numbering:
    """The motions of a folder of numbered files: file number i is row i."""

    source: Path
    """The conditions file whose rows are numbered."""
    ids: tuple[str, ...]
    """Opaque ids."""
    samples: tuple[int, ...]


def leading_axes(shape: tuple[int, ...]) -> tuple[int, ...] | None:
    """The axes before those of a pose, (22, 3) or 66 numbers; None if the last axes are no pose."""
    if len(shape) >= 2 and shape[-2:] == (N_JOINTS, 3):
        return shape[:-2]
    return shape[:-1] if shape and shape[-1] == POSE_SIZE else None


def is_floating(dtype: np.dtype) -> bool:
    """Return True for the two types that coordinates may have in a file, float32 and float64."""
    return dtype.kind == "f" and dtype.itemsize in (4, 8)


def as_float32(joints: np.ndarray) -> Float[np.ndarray, "..."]:
    """The numbers as a run keeps them, so that every way in scores alike; too large ones become infinite."""
    # Infinity is refused later, in words that name the sequence.
    with np.errstate(over="ignore"):
        return np.asarray(joints, dtype=np.float32)


def write_part(
    path: Path,
    sequence_ids: Sequence[str],
    seeds: Sequence[Sequence[int]],
    samples: Sequence[PredictionRows],
    *,
    protocol_version: int,
) -> None:
    """Write the motions of one batch, whole or not at all, sample by sample.

    Args:
        path: The Parquet file.
        sequence_ids: Of the batch's rows.
        seeds: For each sample the noise seed of each row.
        samples: For each sample the motions of the batch.
        protocol_version: Stands in the file's metadata.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    batches = [_record_batch(sequence_ids, sample, seeds[sample], motions) for sample, motions in enumerate(samples)]
    write_table(path, batches, batches[0].schema, protocol_version=protocol_version)


def read_part(
    path: Path, sequence_ids: Sequence[str], *, samples: int, joints: int
) -> Float[np.ndarray, "batch samples frames joints 3"]:
    """Read the motions of one batch, which all have the same length.

    Args:
        path: A file of :func:`write_part`.
        sequence_ids: Of the batch's rows.
        samples: Number of samples.
        joints: Number of joints.

    Raises:
        PredictionsError: if the file is missing or damaged, or holds other motions.
    """
    remedy = "Delete it and run the same command again: it resumes."
    try:
        rows = read_parquet(path, verify=True)
    except (FileNotFoundError, pa.ArrowInvalid, OSError, InputFileError) as error:
        raise PredictionsError(f"{path}: expected the motions of a batch, found no readable file. {remedy}") from error
    expected = [(sample, name) for sample in range(samples) for name in sequence_ids]
    fits = rows.schema.equals(predictions_schema(joints), check_metadata=False)
    if not fits or list(zip(rows["sample"].to_pylist(), rows["sequence_id"].to_pylist(), strict=True)) != expected:
        raise PredictionsError(
            f"{path}: expected {samples} motions of {joints} joints for each of {len(sequence_ids)} sequences, found"
            f" others. {remedy}"
        )
    found = rows["joints"].combine_chunks()
    lengths = found.value_lengths().to_numpy()
    values = found.flatten().flatten().to_numpy()
    if (lengths != lengths[0]).any() or not np.isfinite(values).all():
        raise PredictionsError(f"{path}: expected finite motions of one length, found others. {remedy}")
    shape = (samples, len(sequence_ids), int(lengths[0]), joints, 3)
    return np.swapaxes(values.reshape(shape), 0, 1)


def _record_batch(ids: Sequence[str], sample: int, seeds: Sequence[int], motions: PredictionRows) -> pa.RecordBatch:
    values = pa.array(motions.values.astype(np.float32).reshape(-1))
    offsets = pa.array(motions.offsets.astype(np.int32))
    pose_size = motions.values.shape[1] * 3
    joints = pa.ListArray.from_arrays(offsets, pa.FixedSizeListArray.from_arrays(values, pose_size))
    schema = predictions_schema(pose_size // 3, gaze=motions.gaze is not None)
    columns = [
        pa.array(ids, pa.string()),
        pa.array([sample] * len(ids), pa.int32()),
        pa.array(seeds, pa.int64()),
        joints.cast(schema.field("joints").type),
    ]
    if motions.gaze is None:
        return pa.RecordBatch.from_arrays(columns, schema=schema)
    for part, name in enumerate(GAZE_COLUMNS):
        rays = pa.array(motions.gaze[:, part].astype(np.float32).reshape(-1))
        frames = pa.ListArray.from_arrays(offsets, pa.FixedSizeListArray.from_arrays(rays, 3))
        columns.append(frames.cast(schema.field(name).type))
    return pa.RecordBatch.from_arrays(columns, schema=schema)


_NAME = "frames.bin"


class UnpackedFrames:
    """Frames of motions, float32, after one another in a temporary file.

    The file lives as long as the object that wrote it. Copies in other processes read the same file. It is read, never
    mapped, because pages of a mapped file count as memory of the process.

    Args:
        folder: Holds the file.
        starts: First frame of each motion in the file, then the number of all frames.
        width: Numbers of one frame.
    """

    def __init__(self, folder: tempfile.TemporaryDirectory, starts: Int[np.ndarray, " _"], width: int) -> None:
        self._folder: tempfile.TemporaryDirectory | None = folder
        self._path = Path(folder.name) / _NAME
        self._starts = starts
        self._width = width

    @classmethod
    def of(cls, motions: Iterable[np.ndarray], width: int) -> UnpackedFrames:
        """Write motions, each of any number of frames of ``width`` numbers.

        Raises:
            OSError: if the temporary folder is full.
        """
        folder = tempfile.TemporaryDirectory(prefix="prbench-", ignore_cleanup_errors=True)
        starts = [0]
        with open(Path(folder.name) / _NAME, "wb") as file:
            for motion in motions:
                file.write(np.ascontiguousarray(motion, dtype=np.float32).data)
                starts.append(starts[-1] + motion.size // width)
        return cls(folder, np.array(starts, dtype=np.int64), width)

    def rows(self, rows: Sequence[int]) -> Iterator[Float[np.ndarray, "frames width"]]:
        """Read some motions, in the order given."""
        with open(self._path, "rb") as file:
            for row in rows:
                start, stop = self._starts[row : row + 2].tolist()
                file.seek(4 * self._width * start)
                yield np.fromfile(file, np.float32, self._width * (stop - start)).reshape(-1, self._width)

    def __getstate__(self) -> dict[str, Any]:
        # The temporary folder belongs to the process that made it.
        return {**self.__dict__, "_folder": None}
