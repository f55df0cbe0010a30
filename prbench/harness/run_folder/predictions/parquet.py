"""Predictions as Parquet: a file, or a folder of parts as a run leaves them."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.errors import PredictionsError
from prbench.files.arrays import open_parquet
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.predictions.rows import POSE_SIZE, PredictionRows, as_float32
from prbench.harness.run_folder.scores import GAZE_COLUMNS

_CACHED_BYTES = 64 * 1024**2
_JOINTS_FORM = f"a list of frames, each {POSE_SIZE} numbers (22 joints, x y z)"


def index_parquet(paths: tuple[Path, ...]) -> dict[str, Any]:
    """Read the ids and samples of one file or several, whose rows count on.

    Returns:
        The fields of :class:`~prbench.harness.run_folder.predictions.Predictions`.

    Raises:
        PredictionsError: if a file cannot be read, or columns are missing or of a wrong kind.
    """
    names = _open(paths[0]).schema_arrow.names
    id_column = next((name for name in ("sequence_id", "opaque_id") if name in names), None)
    if id_column is None:
        raise PredictionsError(f"{paths[0]}: expected a column 'sequence_id' or 'opaque_id', found {', '.join(names)}.")
    gaze: tuple[str, ...] = ()
    ids: list[str] = []
    samples: list[int] = []
    groups: list[tuple[Path, int, int, int]] = []
    for part in paths:
        file = _open(part)
        own_gaze = _checked_columns(part, file.schema_arrow, id_column)
        gaze = own_gaze if part == paths[0] else gaze
        if own_gaze != gaze:
            raise PredictionsError(f"{part}: expected the same columns as in {paths[0]}, found gaze in one of the two.")
        columns = [id_column, "sample"] if "sample" in file.schema_arrow.names else [id_column]
        before = len(ids)
        for number in range(file.num_row_groups):
            with _naming(part):
                rows = file.read_row_group(number, columns=columns)
            if any(rows[name].null_count for name in columns):
                raise PredictionsError(f"{part}: expected a value in every row of {' and '.join(columns)}.")
            groups.append((part, number, len(ids), len(ids) - before))
            # Interned: the table and the scores name the same sequences, and each name is kept once.
            ids += map(sys.intern, rows[id_column].to_pylist())
            samples += rows["sample"].to_pylist() if "sample" in columns else [0] * rows.num_rows
    return {
        "paths": paths,
        "id_column": id_column,
        "ids": tuple(ids),
        "samples": tuple(samples),
        "store": ParquetMotions(tuple(groups), gaze),
        "has_gaze": bool(gaze),
    }


@dataclass(frozen=True)
class ParquetMotions:
    """Reads motions a row group at a time; some stay in memory. Goes to workers, so it holds paths, not open files.

    Attributes:
        groups: File, number in it, first row among those of all files, and first row in the file.
        gaze: The columns of gaze; empty for motions without gaze.
    """

    groups: tuple[tuple[Path, int, int, int], ...]
    gaze: tuple[str, ...] = ()
    _cache: dict[int, PredictionRows] = field(default_factory=dict, repr=False)

    def motions(self, rows: Sequence[int]) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Joints of some rows in the order given, and their gaze; no gaze where the motions bring none."""
        joints: list[np.ndarray] = [np.empty(0)] * len(rows)
        rays: list[np.ndarray] = [np.empty(0)] * (len(rows) if self.gaze else 0)
        # In the order of the file, so that no row group is read twice.
        for place in sorted(range(len(rows)), key=lambda i: rows[i]):
            group = self._group_of(rows[place])
            motions = self._read(group)
            row = rows[place] - self.groups[group][2]
            frames = slice(motions.offsets[row], motions.offsets[row + 1])
            joints[place] = motions.values[frames]
            if motions.gaze is not None:
                rays[place] = motions.gaze[frames]
        return joints, rays

    def where(self, row: int) -> str:
        """The file that a row stands in, for messages."""
        return str(self.groups[self._group_of(row)][0])

    @cached_property
    def _starts(self) -> np.ndarray:
        return np.array([start for _, _, start, _ in self.groups])

    def _group_of(self, row: int) -> int:
        return int(np.searchsorted(self._starts, row, side="right")) - 1

    def _read(self, number: int) -> PredictionRows:
        if number in self._cache:
            return self._cache[number]
        path, group, _, first_row = self.groups[number]
        with _naming(path):
            table = _open(path).read_row_group(group, columns=["joints", *self.gaze])
        rows = _as_rows(table["joints"].combine_chunks(), path, first_row=first_row)
        if self.gaze:
            columns = [_rays(table[name].combine_chunks(), path, name) for name in self.gaze]
            for name, (_, offsets) in zip(self.gaze, columns, strict=True):
                other = np.flatnonzero(np.diff(offsets) != np.diff(rows.offsets))
                if other.size:
                    row = int(other[0])
                    frames, found = np.diff(rows.offsets)[row], np.diff(offsets)[row]
                    raise PredictionsError(
                        f"{path}, row {first_row + row}, column '{name}': expected gaze in each of its {frames} frames,"
                        f" found {found}."
                    )
            rows = PredictionRows(rows.values, rows.offsets, np.stack([values for values, _ in columns], axis=1))
        # The sequences of a window are asked for in parts, and lie in the same row groups.
        if sum(kept.values.nbytes for kept in self._cache.values()) > _CACHED_BYTES:
            self._cache.clear()
        self._cache[number] = rows
        return rows


def _flattened(column: pa.Array) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], pa.Array]:
    """Take nested lists apart.

    Returns:
        Where the items of each row begin, where the numbers of each item begin, the sizes of the lists of each level
        inside an item, and all numbers.
    """
    rows = _ends(column)
    items = np.arange(rows[-1] + 1)
    sizes = []
    leaves = column.flatten()
    while pa.types.is_nested(leaves.type):
        ends = _ends(leaves)
        items = ends[items]
        sizes.append(np.diff(ends))
        leaves = leaves.flatten()
    return rows, items, sizes, leaves


def _as_rows(column: pa.Array, path: Path, *, first_row: int) -> PredictionRows:
    """Frames as numbers: all of a motion after one another, or however deeply the 66 of a frame are nested in lists."""
    where = f"{path}, column 'joints'"
    if column.null_count:
        raise PredictionsError(f"{where}: expected {_JOINTS_FORM} in every row, found a null.")
    rows, frames, sizes, leaves = _flattened(column)
    values = _numbers(leaves)
    if not sizes:
        wrong = np.flatnonzero(np.diff(rows) % POSE_SIZE)
        if wrong.size:
            raise PredictionsError(
                f"{where}, row {first_row + wrong[0]}: expected {_JOINTS_FORM}, or all frames after one another"
                f" (n × {POSE_SIZE} numbers), found {np.diff(rows)[wrong[0]]} numbers."
            )
        return PredictionRows(values.reshape(-1, N_JOINTS, 3), rows // POSE_SIZE)
    if len(sizes) > 1 and (sizes[-1] != 3).any():
        found = int(sizes[-1][sizes[-1] != 3][0])
        raise PredictionsError(f"{where}: expected x y z for each of 22 joints, found {found} numbers.")
    wrong = np.flatnonzero(np.diff(frames) != POSE_SIZE)
    if wrong.size:
        row = int(np.searchsorted(rows, wrong[0], side="right")) - 1
        raise PredictionsError(
            f"{where}, row {first_row + row}, frame {wrong[0] - rows[row]}: expected {_JOINTS_FORM}, found"
            f" {np.diff(frames)[wrong[0]]} numbers."
        )
    return PredictionRows(values.reshape(-1, N_JOINTS, 3), rows)


def _rays(column: pa.Array, path: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return points or directions of all rows after one another, (total, 3), and where each row begins."""
    rows, items, _, leaves = _flattened(column)
    offsets = items[rows]
    if (offsets % 3).any() or not (pa.types.is_float32(leaves.type) or pa.types.is_float64(leaves.type)):
        raise PredictionsError(f"{path}, column '{name}': expected x y z for each frame, found {column.type}.")
    return _numbers(leaves).reshape(-1, 3), offsets // 3


def _numbers(leaves: pa.Array) -> np.ndarray:
    """Values as float32; a missing number is NaN, which no motion may hold."""
    return as_float32(leaves.to_numpy(zero_copy_only=False))


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


def _checked_columns(path: Path, schema: pa.Schema, id_column: str) -> tuple[str, ...]:
    """Return the columns of gaze, both or none.

    Raises:
        PredictionsError: if a column is missing or of another kind.
    """
    for name in (id_column, "joints"):
        if name not in schema.names:
            raise PredictionsError(f"{path}: expected a column '{name}', found {', '.join(schema.names)}.")
    gaze = tuple(name for name in GAZE_COLUMNS if name in schema.names)
    if len(gaze) == 1:
        raise PredictionsError(f"{path}: expected both columns {' and '.join(GAZE_COLUMNS)}, found {gaze[0]} alone.")
    kinds = {name: schema.field(name).type for name in schema.names}
    text = kinds[id_column].value_type if pa.types.is_dictionary(kinds[id_column]) else kinds[id_column]
    is_text = pa.types.is_string(text) or pa.types.is_large_string(text) or pa.types.is_string_view(text)
    leaf = kinds["joints"]
    is_lists = _is_list(leaf)
    while is_lists and pa.types.is_nested(leaf):
        is_lists = _is_list(leaf) or pa.types.is_fixed_size_list(leaf)
        leaf = leaf.value_type if is_lists else leaf
    is_floating = pa.types.is_float32(leaf) or pa.types.is_float64(leaf)
    expected = {
        id_column: (is_text, "text"),
        "sample": (pa.types.is_integer(kinds.get("sample", pa.int32())), "whole numbers"),
        "joints": (
            is_lists and is_floating,
            "numbers with decimals (float or double)" if is_lists else _JOINTS_FORM,
        ),
        **{name: (_is_list(kinds[name]), "a list of frames") for name in gaze},
    }
    for name, (fits, wanted) in expected.items():
        if not fits:
            raise PredictionsError(f"{path}, column '{name}': expected {wanted}, found {kinds[name]}.")
    return gaze


def _is_list(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or pa.types.is_large_list(kind)
