"""Predictions as Parquet: a file, or a folder of parts as a run leaves them."""

from __future__ import annotations

import contextlib
import sys
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.errors import PredictionsError
from prbench.files.arrays import open_parquet
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.predictions.rows import (
    POSE_SIZE,
    IndexedRows,
    PredictionRows,
    UnpackedFrames,
    as_float32,
)
from prbench.harness.run_folder.scores import GAZE_COLUMNS

_CACHED_BYTES = 64 * 1024**2
_READ_AGAIN = 4
"""Times that row groups are read at most, on average, before the motions are unpacked instead."""
_JOINTS_FORM = f"a list of frames, each {POSE_SIZE} numbers (22 joints, x y z)"


def index_parquet(paths: tuple[Path, ...]) -> IndexedRows:
    """Read the ids and samples of one file or several, whose rows count on.

    Raises:
        PredictionsError: if a file cannot be read, or columns are missing or of a wrong kind.
    """
    id_column = _id_column(paths[0])
    has_gaze = _has_gaze(paths[0])
    ids: list[str] = []
    samples: list[int] = []
    groups: list[_RowGroup] = []
    for part in paths:
        file = _open(part)
        _check_columns(part, file.schema_arrow, id_column)
        if _has_gaze(part) != has_gaze:
            raise PredictionsError(f"{part}: expected the same columns as in {paths[0]}, found gaze in one of the two.")
        columns = [id_column, "sample"] if "sample" in file.schema_arrow.names else [id_column]
        before = len(ids)
        for number in range(file.num_row_groups):
            with _naming(part):
                rows = file.read_row_group(number, columns=columns)
            if any(rows[name].null_count for name in columns):
                raise PredictionsError(f"{part}: expected a value in every row of {' and '.join(columns)}.")
            groups.append(_RowGroup(part, number, len(ids), len(ids) - before))
            # Interned: the table and the scores name the same sequences, and each name is kept once.
            ids += map(sys.intern, rows[id_column].to_pylist())
            samples += rows["sample"].to_pylist() if "sample" in columns else [0] * rows.num_rows
    return IndexedRows(
        paths, id_column, tuple(ids), tuple(samples), None, ParquetMotions(tuple(groups), has_gaze), has_gaze
    )


@dataclass(frozen=True)
class _RowGroup:
    path: Path
    number: int
    start: int
    """Its first row among those of all files."""
    start_in_file: int


@dataclass(frozen=True)
class ParquetMotions:
    """Reads motions a row group at a time; those that were asked for last stay in memory."""

    groups: tuple[_RowGroup, ...]
    has_gaze: bool = False
    _cache: OrderedDict[_RowGroup, PredictionRows] = field(default_factory=OrderedDict, repr=False)
    _unpacked: dict[str, UnpackedFrames] = field(default_factory=dict, repr=False)

    def make_ready(self, together: Iterable[Sequence[int]] = ()) -> None:
        """Unpack all motions into a temporary file if row groups would be read again and again."""
        reads = sum(len(np.unique(np.searchsorted(self._starts, rows, side="right"))) for rows in together)
        if reads <= _READ_AGAIN * len(self.groups) or self._unpacked:
            return
        self._unpacked["joints"] = UnpackedFrames.of(self._all_joints(), POSE_SIZE)
        if self.has_gaze:
            self._unpacked["gaze"] = UnpackedFrames.of(self._all_gaze(), 6)

    def _all_joints(self) -> Iterator[np.ndarray]:
        for group in self.groups:
            rows = self._read(group, {})
            yield from np.split(rows.values, rows.offsets[1:-1])

    def _all_gaze(self) -> Iterator[np.ndarray]:
        for group in self.groups:
            rows = _open(group.path).metadata.row_group(group.number).num_rows
            yield from self.gaze(range(group.start, group.start + rows))

    def motions(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`; every row group is read once, whatever the order of the rows."""
        if "joints" in self._unpacked:
            return [frames.reshape(-1, N_JOINTS, 3) for frames in self._unpacked["joints"].rows(rows)]
        found: list[np.ndarray] = [np.empty(0)] * len(rows)
        opened: dict[Path, pq.ParquetFile] = {}
        # In the order of the file, so that no row group is read twice.
        for place in sorted(range(len(rows)), key=lambda i: rows[i]):
            group = self._group_of(rows[place])
            motions = self._read(group, opened)
            row = rows[place] - group.start
            found[place] = motions.values[motions.offsets[row] : motions.offsets[row + 1]]
        # What the next rows may need stays: those of a window are asked for in parts, and lie in the same row groups.
        used = {self._group_of(row) for row in rows}
        for group in [group for group in self._cache if group not in used]:
            del self._cache[group]
        return found

    def gaze(self, rows: Sequence[int]) -> list[np.ndarray]:
        """See :class:`MotionStore`."""
        if "gaze" in self._unpacked:
            return [rays.reshape(-1, 2, 3) for rays in self._unpacked["gaze"].rows(rows)]
        found: list[np.ndarray] = [np.empty(0)] * len(rows)
        by_group: dict[_RowGroup, list[int]] = {}
        for place, row in enumerate(rows):
            by_group.setdefault(self._group_of(row), []).append(place)
        for group, places in by_group.items():
            with _naming(group.path):
                table = _open(group.path).read_row_group(group.number, columns=list(GAZE_COLUMNS))
            columns = [_rays(table[name].combine_chunks(), group, name) for name in GAZE_COLUMNS]
            for place in places:
                row = rows[place] - group.start
                parts = [values[offsets[row] : offsets[row + 1]] for values, offsets in columns]
                if len(parts[0]) != len(parts[1]):
                    raise PredictionsError(
                        f"{group.path}, row {group.start_in_file + row}: expected as many gaze origins as directions,"
                        f" found {len(parts[0])} and {len(parts[1])}."
                    )
                found[place] = np.stack(parts, axis=1)
        return found

    def where(self, row: int) -> str:
        """See :class:`MotionStore`."""
        return str(self._group_of(row).path)

    @cached_property
    def _starts(self) -> np.ndarray:
        return np.array([group.start for group in self.groups])

    def _group_of(self, row: int) -> _RowGroup:
        return self.groups[int(np.searchsorted(self._starts, row, side="right")) - 1]

    def _read(self, group: _RowGroup, opened: dict[Path, pq.ParquetFile]) -> PredictionRows:
        if group not in self._cache:
            if group.path not in opened:
                opened[group.path] = _open(group.path)
            with _naming(group.path):
                column = opened[group.path].read_row_group(group.number, columns=["joints"])["joints"].combine_chunks()
            self._cache[group] = _as_rows(column, group.path, first_row=group.start_in_file)
            # The group at hand always stays, however large it is.
            while len(self._cache) > 1 and sum(rows.values.nbytes for rows in self._cache.values()) > _CACHED_BYTES:
                self._cache.popitem(last=False)
        self._cache.move_to_end(group)
        return self._cache[group]


def _as_rows(column: pa.Array, path: Path, *, first_row: int) -> PredictionRows:
    """Frames as numbers: all of a motion after one another, or however deeply the 66 of a frame are nested in lists."""
    if column.null_count:
        raise PredictionsError(f"{path}, column 'joints': expected {_JOINTS_FORM} in every row, found a null.")
    offsets = _ends(column)
    leaves = column.flatten()
    if not pa.types.is_nested(leaves.type):
        return _from_flat(leaves, offsets, path, first_row=first_row)
    frame_ends = np.arange(offsets[-1] + 1)
    sizes_of_lists = []
    while pa.types.is_nested(leaves.type):
        ends = _ends(leaves)
        frame_ends = ends[frame_ends]
        sizes_of_lists.append(np.diff(ends))
        leaves = leaves.flatten()
    if len(sizes_of_lists) > 1 and (sizes_of_lists[-1] != 3).any():
        found = int(sizes_of_lists[-1][sizes_of_lists[-1] != 3][0])
        raise PredictionsError(f"{path}, column 'joints': expected x y z for each of 22 joints, found {found} numbers.")
    sizes = np.diff(frame_ends)
    if (sizes != POSE_SIZE).any():
        frame = int(np.flatnonzero(sizes != POSE_SIZE)[0])
        row = int(np.searchsorted(offsets, frame, side="right")) - 1
        raise PredictionsError(
            f"{path}, column 'joints', row {first_row + row}, frame {frame - offsets[row]}:"
            f" expected {_JOINTS_FORM}, found {sizes[frame]} numbers."
        )
    return PredictionRows(_numbers(leaves), offsets)


def _rays(column: pa.Array, group: _RowGroup, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return points or directions of all rows after one another, (total, 3), and where each row begins."""
    offsets = _ends(column)
    leaves = column.flatten()
    while pa.types.is_nested(leaves.type):
        offsets = _ends(leaves)[offsets]
        leaves = leaves.flatten()
    wrong = np.flatnonzero(offsets % 3)
    if wrong.size or not (pa.types.is_float32(leaves.type) or pa.types.is_float64(leaves.type)):
        raise PredictionsError(f"{group.path}, column '{name}': expected x y z for each frame, found {column.type}.")
    return as_float32(leaves.to_numpy(zero_copy_only=False)).reshape(-1, 3), offsets // 3


def _from_flat(leaves: pa.Array, offsets: np.ndarray, path: Path, *, first_row: int) -> PredictionRows:
    sizes = np.diff(offsets)
    if (sizes % POSE_SIZE).any():
        row = int(np.flatnonzero(sizes % POSE_SIZE)[0])
        raise PredictionsError(
            f"{path}, column 'joints', row {first_row + row}: expected {_JOINTS_FORM}, or all frames after one another"
            f" (n × {POSE_SIZE} numbers), found {sizes[row]} numbers."
        )
    return PredictionRows(_numbers(leaves), offsets // POSE_SIZE)


def _numbers(leaves: pa.Array) -> np.ndarray:
    """float32 poses; a missing number is NaN, which no motion may hold."""
    return as_float32(leaves.to_numpy(zero_copy_only=False)).reshape(-1, N_JOINTS, 3)


def _ends(lists: pa.Array) -> np.ndarray:
    """Return the place at which each list begins among all items, then the number of items; a null holds none."""
    lengths = lists.value_lengths().fill_null(0).to_numpy(zero_copy_only=False)
    return np.concatenate(([0], np.cumsum(lengths, dtype=np.int64)))


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into an error that names it; bytes may be damaged anywhere."""
    try:
        yield
    except FileNotFoundError as error:
        raise PredictionsError(f"{path}: expected a predictions file, found none.") from error
    except (pa.ArrowException, OSError) as error:
        if isinstance(error, MemoryError):
            raise
        first = str(error).splitlines()[0] if str(error) else "damaged"
        raise PredictionsError(
            f"{path}: expected a readable Parquet file, found another form or a damaged one ({first})."
            " Write it again as Parquet; parts of a run are made again by the same `prbench run`."
        ) from error


def _open(path: Path) -> pq.ParquetFile:
    with _naming(path):
        return open_parquet(path, verify=True)


def _has_gaze(path: Path) -> bool:
    """Return True if a file has both columns of gaze.

    Raises:
        PredictionsError: if it has one of them alone, or one that is no list.
    """
    schema = _open(path).schema_arrow
    present = [name for name in GAZE_COLUMNS if name in schema.names]
    if len(present) == 1:
        raise PredictionsError(f"{path}: expected both columns {' and '.join(GAZE_COLUMNS)}, found {present[0]} alone.")
    for name in present:
        kind = schema.field(name).type
        if not (pa.types.is_list(kind) or pa.types.is_large_list(kind)):
            raise PredictionsError(f"{path}, column '{name}': expected a list of frames, found {kind}.")
    return bool(present)


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
    if not (pa.types.is_list(kind) or pa.types.is_large_list(kind)):
        raise PredictionsError(f"{path}, column 'joints': expected {_JOINTS_FORM}, found {kind}.")
    leaf = kind.value_type
    while pa.types.is_nested(leaf):
        if pa.types.is_struct(leaf) or pa.types.is_map(leaf) or pa.types.is_union(leaf):
            raise PredictionsError(f"{path}, column 'joints': expected {_JOINTS_FORM}, found {kind}.")
        leaf = leaf.value_type
    if not (pa.types.is_float32(leaf) or pa.types.is_float64(leaf)):
        raise PredictionsError(
            f"{path}, column 'joints': expected numbers with decimals (float or double), found {kind}."
        )


def _is_text(kind: pa.DataType) -> bool:
    if pa.types.is_dictionary(kind):
        return _is_text(kind.value_type)
    return pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind)
