"""Generated motions of a run, written a whole batch at a time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from prbench.runs.predictions.rows import POSE_SIZE, PredictionRows
from prbench.runs.schema import PREDICTIONS
from prbench.sequences.write import write_table


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
    write_table(path, batches, PREDICTIONS, protocol_version=protocol_version)


def _record_batch(ids: Sequence[str], sample: int, seeds: Sequence[int], motions: PredictionRows) -> pa.RecordBatch:
    values = pa.array(motions.values.astype(np.float32).reshape(-1))
    offsets = pa.array(motions.offsets.astype(np.int32))
    joints = pa.ListArray.from_arrays(offsets, pa.FixedSizeListArray.from_arrays(values, POSE_SIZE))
    columns = [
        pa.array(ids, pa.string()),
        pa.array([sample] * len(ids), pa.int32()),
        pa.array(seeds, pa.int64()),
        joints.cast(PREDICTIONS.field("joints").type),
    ]
    return pa.RecordBatch.from_arrays(columns, schema=PREDICTIONS)
