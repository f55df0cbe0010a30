"""Motions after one another, and the Parquet parts in which a run keeps them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

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
    """Motions of some sequences after one another.

    Attributes:
        values: Metres, in the frame of the question; 22 joints in a canonical frame for prime-and-reach.
        offsets: Row at which each motion begins, then the number of all frames.
        gaze: Middle between the eyes (metres) and unit direction of the gaze in each frame; None for motions without
            gaze.
    """

    values: Float[np.ndarray, "total joints 3"]
    offsets: Int[np.ndarray, " offsets"]
    gaze: Float[np.ndarray, "total 2 3"] | None = None

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


def as_float32(joints: np.ndarray) -> Float[np.ndarray, "..."]:
    """The numbers as a run keeps them, so that every way in scores alike; too large ones become infinite."""
    # Infinity is refused later, in words that name the sequence.
    with np.errstate(over="ignore"):
        return np.asarray(joints, dtype=np.float32)


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
        """The file that a row stands in and its place there, for messages."""
        return self.places[row]

    def only(self, rows: Sequence[int]) -> ArrayMotions:
        """Some of the motions, so that a worker is not sent all of them."""
        joints, rays = self.motions(rows)
        return ArrayMotions(tuple(joints), tuple(self.places[row] for row in rows), tuple(rays))


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
        sequence_ids: Ids of the batch's rows.
        seeds: Noise seed of each row, one list a sample.
        samples: Motions of the batch, one entry a sample.
        protocol_version: Stands in the file's metadata.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    batches = []
    for sample, motions in enumerate(samples):
        offsets = pa.array(motions.offsets.astype(np.int32))
        n_joints = motions.values.shape[1]
        schema = predictions_schema(n_joints, gaze=motions.gaze is not None)
        columns = [
            pa.array(sequence_ids, pa.string()),
            pa.array([sample] * len(sequence_ids), pa.int32()),
            pa.array(seeds[sample], pa.int64()),
        ]
        per_frame = [motions.values]
        if motions.gaze is not None:
            per_frame += [motions.gaze[:, part] for part in range(len(GAZE_COLUMNS))]
        for values, field in zip(per_frame, list(schema)[3:], strict=True):
            numbers = pa.array(values.astype(np.float32).reshape(-1))
            frames = pa.FixedSizeListArray.from_arrays(numbers, math.prod(values.shape[1:]))
            columns.append(pa.ListArray.from_arrays(offsets, frames).cast(field.type))
        batches.append(pa.RecordBatch.from_arrays(columns, schema=schema))
    write_table(path, batches, batches[0].schema, protocol_version=protocol_version)


def read_part(
    path: Path, sequence_ids: Sequence[str], *, samples: int, joints: int
) -> Float[np.ndarray, "batch samples frames joints 3"]:
    """Read the motions of one batch, which all have the same length.

    Args:
        path: A file of :func:`write_part`.
        sequence_ids: Ids of the batch's rows.
        samples: Number of samples.
        joints: Number of joints.

    Raises:
        PredictionsError: if the file is missing or damaged, or holds other motions.
    """
    remedy = "Delete it and run the same command again: it resumes."
    try:
        rows = read_parquet(path, verify=True)
    except (pa.ArrowInvalid, OSError, InputFileError) as error:
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
