"""Columns of predictions and scores, and ``scores.parquet``: one value of one metric of one motion a row."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from prbench.errors import RunError
from prbench.files import arrays, bounded, storage
from prbench.geometry.skeleton import N_JOINTS
from prbench.shown import quoted

RUN_SCHEMA_VERSION = 1

# One ray a frame from between the eyes, of motions that bring gaze; columns are named as in the sequence table.
GAZE_COLUMNS = ["gaze_origin", "gaze_direction"]


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


# One value a row; rates are 0 or 1.
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


_CODED = pa.schema(
    [
        field.with_type(pa.dictionary(pa.int32(), pa.string())) if pa.types.is_string(field.type) else field
        for field in SCORES
    ]
)
# Rows of a piece of :meth:`CodedScores.pieces`.
PIECE = 64 * 1024
# Rows of a row group: their texts take 70 MB while they are written.
_ROW_GROUP = 256 * 1024
_KEYS = ["dataset", "sequence_id", "sample", "metric"]


def long_form(sequence_ids: Sequence[str], dataset: str, columns: Mapping[str, Float[np.ndarray, " n"]]) -> pa.Table:
    """Return rows of ``scores.parquet`` from one value a case in each metric; a case without a value has no row."""
    metrics = list(columns)
    values = np.stack([columns[name] for name in metrics], axis=1)
    case, metric = np.nonzero(np.isfinite(values))
    rows = ([sequence_ids[row] for row in case.tolist()], [dataset] * len(case), np.zeros(len(case), np.int32))
    rows += ([metrics[column] for column in metric.tolist()], values[case, metric], [None] * len(case))
    return pa.Table.from_arrays([pa.array(each, kind) for each, kind in zip(rows, SCORES.types)], schema=SCORES)


def write_scores(path: Path, tables: Iterable[pa.Table]) -> None:
    """Write the long form, whole or not at all, in the order given.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    schema = SCORES.with_metadata({"prbench_run_schema_version": str(RUN_SCHEMA_VERSION)})
    with (
        storage.atomic_path(path) as temporary,
        open(temporary, "wb") as file,
        pq.ParquetWriter(file, schema, compression="zstd", use_dictionary=True) as writer,
    ):
        for table in tables:
            writer.write_table(table.cast(schema))
            del table  # before the next one is made


def read_scores(path: Path) -> pa.Table:
    """Read the long form.

    Raises:
        RunError: if the file is missing, damaged, has other columns, or several values for one sequence, sample and
            metric.
    """
    return CodedScores.read(path).long_form()


@dataclass(frozen=True, eq=False)
class CodedScores:
    """Rows of ``scores.parquet`` in their order, with numbers in place of texts, which would take 150 bytes a row.

    Each text stands once, in the order in which texts first appear; the rows hold its number.
    """

    rows: pa.Table

    def __len__(self) -> int:
        return self.rows.num_rows

    @classmethod
    def of(cls, tables: Iterable[pa.Table | pa.RecordBatch]) -> CodedScores:
        """Take up rows in long form, some at a time."""
        coded = [SCORES.empty_table().cast(_CODED)]
        for table in tables:
            whole = pa.Table.from_batches([table]) if isinstance(table, pa.RecordBatch) else table
            coded.append(whole.cast(_CODED))
        return cls(pa.concat_tables(coded).unify_dictionaries().combine_chunks())

    @classmethod
    @bounded.foreign_input()
    def read(cls, path: Path) -> CodedScores:
        """Read ``scores.parquet`` a part at a time.

        Raises:
            RunError: if the file is missing, damaged, has other columns, or several values for one sequence, sample and
                metric.
        """
        try:
            file = arrays.open_parquet(path)
            columns = file.schema_arrow
            if not columns.equals(SCORES, check_metadata=False):
                problem = f"expected the columns {', '.join(SCORES.names)}, found {', '.join(columns.names)}."
                raise RunError(f"{path}: {problem}")
            scores = cls.of(file.iter_batches(batch_size=PIECE))
        except FileNotFoundError as error:
            remedy = "Run the method again: it resumes."
            raise RunError(f"{path}: expected the scores of a run, found no file. {remedy}") from error
        except (pa.ArrowInvalid, OSError) as error:
            raise RunError(f"{path}: not a readable Parquet file ({error}).") from error
        # Repeated rows would enter a mean twice.
        counts = scores.rows.group_by(_KEYS).aggregate([([], "count_all")])
        if len(counts) < len(scores):
            row = counts.filter(pc.field("count_all") > 1).slice(0, 1).to_pylist()[0]
            name = f"{row['dataset']}, {row['sequence_id']}, sample {row['sample']}, {row['metric']}"
            problem = f"expected one value for each sequence, sample and metric, found more: {quoted(name)}."
            raise RunError(f"{path}: {problem}")
        return scores

    @cached_property
    def sequence_ids(self) -> tuple[str, ...]:
        """The sequences, in the order in which they first appear."""
        return self._texts("sequence_id")

    @cached_property
    def metrics(self) -> tuple[str, ...]:
        """Ids of the metrics."""
        return self._texts("metric")

    @cached_property
    def flags(self) -> tuple[str, ...]:
        """All flags; a row may carry several, joined by semicolons."""
        return self._texts("flag")

    @cached_property
    def sequence(self) -> Int[np.ndarray, " rows"]:
        """Number of each row's sequence among ``sequence_ids``."""
        return self._numbers("sequence_id")

    @cached_property
    def flag(self) -> Int[np.ndarray, " rows"]:
        """Number of each row's flag among ``flags``, or -1."""
        return self._numbers("flag")

    @cached_property
    def value(self) -> Float[np.ndarray, " rows"]:
        """Value of each row."""
        return self.rows["value"].to_numpy()

    def long_form(self, rows: slice = slice(None)) -> pa.Table:
        """Return rows as ``scores.parquet`` has them."""
        start, stop, _ = rows.indices(len(self))
        return self.rows.slice(start, stop - start).cast(SCORES)

    def pieces(self, rows: int = PIECE) -> Iterator[pa.Table]:
        """Yield all rows as ``scores.parquet`` has them, some at a time."""
        for start in range(0, len(self), rows):
            yield self.long_form(slice(start, start + rows))

    def write(self, path: Path) -> None:
        """Write ``scores.parquet``, a row group at a time.

        Raises:
            StorageError: if the disk is full or the folder cannot be written.
        """
        write_scores(path, self.pieces(_ROW_GROUP))

    def rows_of(self, metric: str) -> Int[np.ndarray, " _"]:
        """Return the places of the rows of one metric."""
        if metric not in self.metrics:
            return np.empty(0, dtype=np.int64)
        return np.flatnonzero(self._numbers("metric") == self.metrics.index(metric))

    def only(self, ids: Collection[str]) -> CodedScores:
        """Return the rows of some sequences."""
        wanted = pc.SetLookupOptions(pa.array(sorted(ids), pa.string()), skip_nulls=False)
        kept = pc.call_function("is_in", [self.rows["sequence_id"].cast(pa.string())], wanted)
        return CodedScores.of([self.rows.filter(kept).cast(SCORES)])

    def _texts(self, column: str) -> tuple[str, ...]:
        return tuple(self.rows[column].combine_chunks().dictionary.to_pylist())

    def _numbers(self, column: str) -> Int[np.ndarray, " rows"]:
        return self.rows[column].combine_chunks().indices.fill_null(-1).to_numpy()
