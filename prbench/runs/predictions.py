"""Generated motions on disk: written a whole batch at a time, read back in any order."""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from prbench.errors import PredictionsError
from prbench.runs.schema import PREDICTIONS
from prbench.sequences.write import write_table
from prbench.skeleton import N_JOINTS

_CACHED_BYTES = 256 * 1024**2
_POSE_SIZE = N_JOINTS * 3
_JOINTS_FORM = f"a list of frames, each {_POSE_SIZE} numbers (22 joints, x y z)"


@dataclass(frozen=True)
class PredictionRows:
    """Motions of some sequences after one another."""

    values: Float[np.ndarray, "total 22 3"]
    """Canonical frames, metres."""
    offsets: Int[np.ndarray, " offsets"]
    """Where each motion begins, then the number of all frames."""

    @classmethod
    def from_padded(
        cls, joints: Float[np.ndarray, "batch frames 22 3"], n_frames: Int[np.ndarray, " batch"]
    ) -> PredictionRows:
        """Leave out what stands behind the last frame of each row."""
        valid = np.arange(joints.shape[1]) < n_frames[:, None]
        return cls(joints[valid], np.concatenate(([0], np.cumsum(n_frames))))


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
    joints = pa.ListArray.from_arrays(offsets, pa.FixedSizeListArray.from_arrays(values, _POSE_SIZE))
    columns = [
        pa.array(ids, pa.string()),
        pa.array([sample] * len(ids), pa.int32()),
        pa.array(seeds, pa.int64()),
        joints.cast(PREDICTIONS.field("joints").type),
    ]
    return pa.RecordBatch.from_arrays(columns, schema=PREDICTIONS)


@dataclass(frozen=True)
class Predictions:
    """A predictions file, or a folder of parts, with an index of its rows."""

    paths: tuple[Path, ...]
    id_column: str
    """``sequence_id`` or ``opaque_id``."""
    ids: tuple[str, ...]
    """Of every row, file after file."""
    samples: tuple[int, ...]
    _place: dict[tuple[str, int], tuple[int, int, int]] = field(repr=False)
    """(id, sample) → file, row group, row in it; of repeated rows the last."""
    _cache: OrderedDict[tuple[int, int], PredictionRows] = field(default_factory=OrderedDict, repr=False)

    @classmethod
    def open(cls, path: Path) -> Predictions:
        """Index a Parquet file or the ``part-*.parquet`` of a folder.

        Raises:
            PredictionsError: if there is none, or columns are missing or of a wrong kind.
        """
        paths = (path,) if not path.is_dir() else tuple(sorted(p for p in path.glob("*.parquet") if p.name[0] != "."))
        if not paths:
            raise PredictionsError(f"{path}: expected predictions (*.parquet), found none.")
        id_column = _id_column(paths[0])
        ids: list[str] = []
        samples: list[int] = []
        place: dict[tuple[str, int], tuple[int, int, int]] = {}
        for number, part in enumerate(paths):
            file = _open(part)
            _check_columns(part, file.schema_arrow, id_column)
            columns = [id_column, "sample"] if "sample" in file.schema_arrow.names else [id_column]
            for group in range(file.num_row_groups):
                with _naming(part):
                    rows = file.read_row_group(group, columns=columns)
                if any(rows[name].null_count for name in columns):
                    raise PredictionsError(f"{part}: expected a value in every row of {' and '.join(columns)}.")
                names = rows[id_column].to_pylist()
                drawn = rows["sample"].to_pylist() if "sample" in columns else [0] * len(names)
                place |= {key: (number, group, row) for row, key in enumerate(zip(names, drawn))}
                ids += names
                samples += drawn
        return cls(paths, id_column, tuple(ids), tuple(samples), place)

    def __contains__(self, key: tuple[str, int]) -> bool:
        return key in self._place

    def motions(self, ids: Sequence[str], sample: int) -> PredictionRows:
        """The motions of the given sequences, in the given order.

        Raises:
            PredictionsError: if a row is empty or a frame does not have 22 joints.
        """
        found: list[np.ndarray] = []
        for name in ids:
            file, group, row = self._place[name, sample]
            rows = self._row_group(file, group)
            motion = rows.values[rows.offsets[row] : rows.offsets[row + 1]]
            if not len(motion):
                raise PredictionsError(f"{self.paths[file]}, {name}: expected a motion, found no frames.")
            found.append(motion)
        lengths = [len(motion) for motion in found]
        return PredictionRows(np.concatenate(found), np.concatenate(([0], np.cumsum(lengths))).astype(np.int64))

    def _row_group(self, file: int, group: int) -> PredictionRows:
        key = (file, group)
        if key not in self._cache:
            opened = _open(self.paths[file])
            with _naming(self.paths[file]):
                column = opened.read_row_group(group, columns=["joints"])["joints"].combine_chunks()
            before = sum(opened.metadata.row_group(earlier).num_rows for earlier in range(group))
            self._cache[key] = _as_rows(column, self.paths[file], first_row=before)
            while len(self._cache) > 1 and sum(rows.values.nbytes for rows in self._cache.values()) > _CACHED_BYTES:
                self._cache.popitem(last=False)
        self._cache.move_to_end(key)
        return self._cache[key]


def _as_rows(column: pa.Array, path: Path, *, first_row: int) -> PredictionRows:
    """Frames as numbers, however deeply the 66 values of a frame are nested in lists."""
    if column.null_count:
        raise PredictionsError(f"{path}, column 'joints': expected {_JOINTS_FORM} in every row, found a null.")
    offsets = _ends(column)
    leaves = column.flatten()
    frame_ends, sizes_of_lists = np.arange(offsets[-1] + 1), []
    while pa.types.is_nested(leaves.type):
        ends = _ends(leaves)
        frame_ends = ends[frame_ends]
        sizes_of_lists.append(np.diff(ends))
        leaves = leaves.flatten()
    if len(sizes_of_lists) > 1 and (sizes_of_lists[-1] != 3).any():
        found = int(sizes_of_lists[-1][sizes_of_lists[-1] != 3][0])
        raise PredictionsError(f"{path}, column 'joints': expected x y z for each of 22 joints, found {found} numbers.")
    values = leaves.to_numpy(zero_copy_only=False)
    sizes = np.diff(frame_ends)
    if (sizes != _POSE_SIZE).any():
        frame = int(np.flatnonzero(sizes != _POSE_SIZE)[0])
        row = int(np.searchsorted(offsets, frame, side="right")) - 1
        raise PredictionsError(
            f"{path}, column 'joints', row {first_row + row}, frame {frame - offsets[row]}:"
            f" expected {_JOINTS_FORM}, found {sizes[frame]} numbers."
        )
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float64)
    return PredictionRows(values.reshape(-1, N_JOINTS, 3), offsets)


def _ends(lists: pa.Array) -> np.ndarray:
    """Where each list begins among all their items, then the number of items; a null holds none."""
    lengths = lists.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
    return np.concatenate(([0], np.cumsum(lengths, dtype=np.int64)))


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into an error that names it; bytes may be damaged anywhere."""
    try:
        yield
    except FileNotFoundError as error:
        raise PredictionsError(f"{path}: expected a predictions file, found none.") from error
    except (pa.ArrowInvalid, OSError) as error:
        first = str(error).splitlines()[0] if str(error) else "damaged"
        raise PredictionsError(
            f"{path}: expected a readable Parquet file, found another form or a damaged one ({first})."
            " Write it again as Parquet; parts of a run are made again by the same `prbench run`."
        ) from error


def _open(path: Path) -> pq.ParquetFile:
    with _naming(path):
        return pq.ParquetFile(path, page_checksum_verification=True)


def _id_column(path: Path) -> str:
    names = _open(path).schema_arrow.names
    for name in ("sequence_id", "opaque_id"):
        if name in names:
            return name
    raise PredictionsError(f"{path}: expected a column 'sequence_id' or 'opaque_id', found {', '.join(names)}.")


def _check_columns(path: Path, schema: pa.Schema, id_column: str) -> None:
    for name in (id_column, "joints"):
        if name not in schema.names:
            raise PredictionsError(f"{path}: expected a column '{name}', found {', '.join(schema.names)}.")
    if not _is_text(schema.field(id_column).type):
        raise PredictionsError(f"{path}, column '{id_column}': expected text, found {schema.field(id_column).type}.")
    if "sample" in schema.names and not pa.types.is_integer(schema.field("sample").type):
        raise PredictionsError(f"{path}, column 'sample': expected whole numbers, found {schema.field('sample').type}.")
    kind = schema.field("joints").type
    frame = kind.value_type if pa.types.is_list(kind) or pa.types.is_large_list(kind) else None
    if frame is None or not pa.types.is_nested(frame):
        raise PredictionsError(f"{path}, column 'joints': expected {_JOINTS_FORM}, found {kind}.")
    while pa.types.is_nested(frame):
        if pa.types.is_struct(frame) or pa.types.is_map(frame):
            raise PredictionsError(f"{path}, column 'joints': expected {_JOINTS_FORM}, found {kind}.")
        frame = frame.value_type
    if not pa.types.is_floating(frame):
        raise PredictionsError(f"{path}, column 'joints': expected numbers with decimals, found {kind}.")


def _is_text(kind: pa.DataType) -> bool:
    if pa.types.is_dictionary(kind):
        return _is_text(kind.value_type)
    return pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
