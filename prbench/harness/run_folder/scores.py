"""Columns of predictions and scores, and ``scores.parquet``: one value of one metric of one motion a row."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from prbench.errors import RunError
from prbench.files.arrays import open_parquet
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_path
from prbench.geometry.skeleton import N_JOINTS
from prbench.shown import quoted

RUN_SCHEMA_VERSION = 1

GAZE_COLUMNS = ["gaze_origin", "gaze_direction"]
"""One ray a frame from between the eyes, of motions that bring gaze; columns are named as in the sequence table."""


def predictions_schema(joints: int = N_JOINTS, *, gaze: bool = False) -> pa.Schema:
    """One generated motion a row, metres, encoded like the sequence table.

    Args:
        joints: Number of joints.
        gaze: The motions bring gaze.
    """
    fields = [
        pa.field("sequence_id", pa.string(), nullable=False),
        pa.field("sample", pa.int32(), nullable=False),
        pa.field("seed", pa.int64(), nullable=False),
        pa.field("joints", pa.list_(pa.list_(pa.float32(), joints * 3)), nullable=False),
    ]
    rays = pa.list_(pa.list_(pa.float32(), 3))
    return pa.schema([*fields, *(pa.field(name, rays, nullable=False) for name in GAZE_COLUMNS if gaze)])


SCORES = pa.schema(
    [
        pa.field("sequence_id", pa.string(), nullable=False),
        pa.field("dataset", pa.string(), nullable=False),
        pa.field("sample", pa.int32(), nullable=False),
        pa.field("metric", pa.string(), nullable=False),
        pa.field("value", pa.float64(), nullable=False),
        pa.field("flag", pa.string(), nullable=True),
    ]
)
"""One value a row; rates are 0 or 1."""


def write_scores(path: Path, tables: Iterable[pa.Table]) -> None:
    """Write the long form, whole or not at all, in the order given.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    schema = SCORES.with_metadata({"prbench_run_schema_version": str(RUN_SCHEMA_VERSION)})
    with (
        atomic_path(path) as temporary,
        open(temporary, "wb") as file,
        pq.ParquetWriter(file, schema, compression="zstd", use_dictionary=True) as writer,
    ):
        for table in tables:
            writer.write_table(table.cast(schema))
            del table  # before the next one is made


@foreign_input()
def read_scores(path: Path) -> pa.Table:
    """Read the long form.

    Raises:
        RunError: if the file is missing, damaged, or has other columns.
    """
    with open_scores(path) as file:
        table = file.read()
    # Repeated rows would enter a mean twice.
    keys = table.group_by(["dataset", "sequence_id", "sample", "metric"]).aggregate([([], "count_all")])
    if len(keys) < len(table):
        raise repeated_row(path, keys.filter(pc.field("count_all") > 1).slice(0, 1).to_pylist()[0])
    return table


@contextlib.contextmanager
def open_scores(path: Path) -> Iterator[pq.ParquetFile]:
    """Open the long form, to be read while the block runs.

    Raises:
        RunError: if the file is missing, damaged, or has other columns.
    """
    try:
        file = open_parquet(path)
        columns = file.schema_arrow
        if columns.equals(SCORES, check_metadata=False):
            yield file
            return
    except FileNotFoundError as error:
        raise RunError(
            f"{path}: expected the scores of a run, found no file. Run the method again: it resumes."
        ) from error
    except (pa.ArrowInvalid, OSError) as error:
        raise RunError(f"{path}: not a readable Parquet file ({error}).") from error
    raise RunError(f"{path}: expected the columns {', '.join(SCORES.names)}, found {', '.join(columns.names)}.")


def repeated_row(path: Path, row: Mapping[str, object]) -> RunError:
    """Return the error of a file that scores one motion twice under one metric."""
    name = f"{row['dataset']}, {row['sequence_id']}, sample {row['sample']}, {row['metric']}"
    return RunError(f"{path}: expected one value for each sequence, sample and metric, found more: {quoted(name)}.")
