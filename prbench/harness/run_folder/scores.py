"""Columns of predictions and scores, and ``scores.parquet``: one value of one metric of one motion a row."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from jaxtyping import Float, Int

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


_ROWS_AT_ONCE = 64 * 1024
_ROW_GROUP = 256 * 1024
"""Rows of a row group: their texts take 70 MB while they are written."""
_NO_FLAG = -1


@dataclass(frozen=True, eq=False)
class CodedScores:
    """Rows of ``scores.parquet`` in their order: 16 bytes a row, where the texts would take 150.

    Each text stands once, in the order in which texts first appear; the rows hold its number.
    """

    sequence_ids: tuple[str, ...]
    datasets: tuple[str, ...]
    metrics: tuple[str, ...]
    flags: tuple[str, ...]
    sequence: Int[np.ndarray, " rows"]
    """Number of each row's sequence among ``sequence_ids``."""
    dataset: Int[np.ndarray, " rows"]
    sample: Int[np.ndarray, " rows"]
    metric: Int[np.ndarray, " rows"]
    value: Float[np.ndarray, " rows"]
    flag: Int[np.ndarray, " rows"]
    """Number of each row's flag among ``flags``, or -1."""

    def __len__(self) -> int:
        return len(self.value)

    @classmethod
    def of(cls, tables: Iterable[pa.Table | pa.RecordBatch]) -> CodedScores:
        """Take up rows in long form, some at a time."""
        texts: dict[str, dict[str, int]] = {name: {} for name in ("sequence_id", "dataset", "metric", "flag")}
        columns = {name: _Growing(np.float64 if name == "value" else np.int8) for name in SCORES.names}
        for table in tables:
            for name in SCORES.names:
                column = table.column(name)
                column = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
                numbers = _codes(column, texts[name]) if name in texts else column.to_numpy()
                columns[name].append(numbers if name == "value" else _narrow(numbers))
        return cls(
            tuple(texts["sequence_id"]),
            tuple(texts["dataset"]),
            tuple(texts["metric"]),
            tuple(texts["flag"]),
            columns["sequence_id"].whole(),
            columns["dataset"].whole(),
            columns["sample"].whole(),
            columns["metric"].whole(),
            columns["value"].whole(),
            columns["flag"].whole(),
        )

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> CodedScores:
        """Read ``scores.parquet`` a part at a time.

        Raises:
            RunError: if the file is missing, damaged, has other columns, or several values for one sequence, sample and
                metric.
        """
        with open_scores(path) as file:
            scores = cls.of(file.iter_batches(batch_size=_ROWS_AT_ONCE))
        repeated = scores._first_repeated()
        if repeated is not None:  # repeated rows would enter a mean twice
            raise repeated_row(path, scores.long_form(slice(repeated, repeated + 1)).to_pylist()[0])
        return scores

    def _first_repeated(self) -> int | None:
        """Return the first of several rows of one dataset, sequence, sample and metric; None without any."""
        # Rows in the order in which prbench writes them ascend, so that a part at a time is looked at.
        starts = range(0, len(self), _ROWS_AT_ONCE)
        if all((np.diff(self._keys(slice(start, start + _ROWS_AT_ONCE + 1))) > 0).all() for start in starts):
            return None
        keys = self._keys(slice(None))
        ordered = np.sort(keys)
        twice = ordered[1:][ordered[1:] == ordered[:-1]]
        return int(np.flatnonzero(np.isin(keys, twice))[0]) if twice.size else None

    def _keys(self, rows: slice) -> Int[np.ndarray, " rows"]:
        """Return one number a row that tells datasets, sequences, samples and metrics apart."""
        lowest = int(self.sample.min(initial=0))  # below 0 in a file that prbench has not written
        samples = int(self.sample.max(initial=0)) - lowest + 1
        keys = self.dataset[rows].astype(np.int64) * len(self.sequence_ids) + self.sequence[rows]
        keys = keys * samples + (self.sample[rows].astype(np.int64) - lowest)
        return keys * len(self.metrics) + self.metric[rows]

    def long_form(self, rows: slice = slice(None)) -> pa.Table:
        """Return rows as ``scores.parquet`` has them."""
        flags = pa.array((*self.flags, None), pa.string())
        flag = pa.array(np.where(self.flag[rows] == _NO_FLAG, len(self.flags), self.flag[rows].astype(np.int64)))
        sequence = self.sequence[rows]
        # Only the ids between these: those of all sequences are many for a few rows.
        first = int(sequence.min(initial=len(self.sequence_ids)))
        last = int(sequence.max(initial=0))
        columns = [
            pa.array(self.sequence_ids[first : last + 1], pa.string()).take(pa.array(sequence - first)),
            pa.array(self.datasets, pa.string()).take(pa.array(self.dataset[rows])),
            pa.array(self.sample[rows].astype(np.int32)),
            pa.array(self.metrics, pa.string()).take(pa.array(self.metric[rows])),
            pa.array(self.value[rows]),
            flags.take(flag),
        ]
        return pa.Table.from_arrays(columns, schema=SCORES)

    def pieces(self, rows: int = _ROWS_AT_ONCE) -> Iterator[pa.Table]:
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
        return np.flatnonzero(self.metric == self.metrics.index(metric))

    def only(self, wanted: Callable[[str], bool]) -> CodedScores:
        """Return the rows of some sequences.

        Args:
            wanted: Says of the id of a sequence whether its rows are kept.
        """
        kept = np.array([wanted(name) for name in self.sequence_ids], dtype=bool)
        rows = np.flatnonzero(kept[self.sequence])
        return CodedScores(
            tuple(name for name in self.sequence_ids if wanted(name)),
            self.datasets,
            self.metrics,
            self.flags,
            (np.cumsum(kept) - 1)[self.sequence[rows]],
            self.dataset[rows],
            self.sample[rows],
            self.metric[rows],
            self.value[rows],
            self.flag[rows],
        )


class _Growing:
    """An array that grows where it lies: parts that are joined at the end are twice in memory then."""

    def __init__(self, kind: type[np.generic]) -> None:
        self._values = np.empty(0, dtype=kind)
        self._count = 0

    def append(self, values: np.ndarray) -> None:
        """Add values; the type widens where they need it."""
        self._values = self._values.astype(np.promote_types(self._values.dtype, values.dtype), copy=False)
        end = self._count + len(values)
        if end > len(self._values):
            self._values.resize(end + end // 8, refcheck=False)
        self._values[self._count : end] = values
        self._count = end

    def whole(self) -> np.ndarray:
        """Return all values; none can be added any more."""
        self._values.resize(self._count, refcheck=False)
        return self._values


def _codes(column: pa.Array, known: dict[str, int]) -> Int[np.ndarray, " rows"]:
    """Return the number of each row's text; texts that were not known get the next numbers."""
    encoded = column.dictionary_encode()
    numbers = [known.setdefault(sys.intern(text), len(known)) for text in encoded.dictionary.to_pylist()]
    places = encoded.indices.fill_null(len(numbers)).to_numpy()
    return np.array([*numbers, _NO_FLAG], dtype=np.int32)[places]


def _narrow(numbers: Int[np.ndarray, " rows"]) -> Int[np.ndarray, " rows"]:
    """Return whole numbers in the shortest type that holds them."""
    largest = int(np.abs(numbers).max(initial=0))
    return numbers.astype(next(kind for kind in (np.int8, np.int16, np.int32) if largest <= np.iinfo(kind).max))
