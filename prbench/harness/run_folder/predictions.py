"""Motions on disk: the Parquet parts in which a run keeps them, and what somebody hands in, whatever the format.

Motions stand after one another (:class:`PredictionRows`). :class:`Predictions` says which there are, and reads single
ones in any order.
"""

from __future__ import annotations

import contextlib
import math
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Float, Int

from prbench.errors import InputFileError, PredictionsError
from prbench.files.arrays import Archive, ArrayHeader, open_parquet, read_parquet
from prbench.files.bounded import foreign_input, open_regular
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.run_folder.scores import GAZE_COLUMNS, predictions_schema
from prbench.limits import MOST_MOTIONS
from prbench.sequences.write import write_table
from prbench.shown import quoted

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

    ``joints`` is padded, (n, N, 22, 3), or holds the frames of all motions after one another, (total, 22, 3); in both
    forms ``n_frames`` tells how many frames each has, and a pose may also be 66 numbers. Without ``joints`` and ids
    every array is named by its sequence, (frames, 22, 3) or (samples, frames, 22, 3).

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
        found = ", ".join(sorted(present)[:10]) or "none"
        remedy = f"{itself} Copy opaque_id, sample and n_frames from the conditions file."
        expected = "the arrays opaque_id (or sequence_id), joints and n_frames"
        raise PredictionsError(f"{path}: expected {expected}, found {found}.{remedy}")
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


# Metadata of a part: digest of what the method was asked (:attr:`prbench.harness.benchmark.CaseWork.questions`).
QUESTION = "prbench_question"


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
        return cls(joints[valid], np.concatenate(([0], np.cumsum(n_frames))), None if gaze is None else gaze[valid])


def write_part(
    path: Path,
    sequence_ids: Sequence[str],
    seeds: Sequence[Sequence[int]],
    samples: Sequence[PredictionRows],
    *,
    protocol_version: int,
    question: str = "",
) -> None:
    """Write the motions of one batch, whole or not at all, sample by sample.

    Args:
        path: The Parquet file.
        sequence_ids: Ids of the batch's rows.
        seeds: Noise seed of each row, one list a sample.
        samples: Motions of the batch, one entry a sample.
        protocol_version: Stands in the file's metadata.
        question: Digest of what the method was asked, which stands there, too.

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    batches = []
    for sample, motions in enumerate(samples):
        offsets = pa.array(motions.offsets.astype(np.int32))
        schema = predictions_schema(motions.values.shape[1], gaze=motions.gaze is not None)
        columns = [
            pa.array(sequence_ids, pa.string()),
            pa.array([sample] * len(sequence_ids), pa.int32()),
            pa.array(seeds[sample], pa.int64()),
        ]
        per_frame = [motions.values]
        if motions.gaze is not None:
            per_frame += [motions.gaze[:, part] for part in range(len(GAZE_COLUMNS))]
        for values, column in zip(per_frame, list(schema)[3:], strict=True):
            numbers = pa.array(values.astype(np.float32).reshape(-1))
            frames = pa.FixedSizeListArray.from_arrays(numbers, math.prod(values.shape[1:]))
            columns.append(pa.ListArray.from_arrays(offsets, frames).cast(column.type))
        batches.append(pa.RecordBatch.from_arrays(columns, schema=schema))
    schema = batches[0].schema.with_metadata({QUESTION: question})
    write_table(path, batches, schema, protocol_version=protocol_version)


def read_part(
    path: Path,
    sequence_ids: Sequence[str],
    *,
    samples: int,
    joints: int,
    n_frames: Int[np.ndarray, " batch"] | None = None,
) -> Float[np.ndarray, "batch samples frames joints 3"]:
    """Read the motions of one batch; what stands beyond the last frame of one is NaN.

    Args:
        path: A file of :func:`write_part`.
        sequence_ids: Ids of the batch's rows.
        samples: Number of samples.
        joints: Number of joints.
        n_frames: Length of each row's motions; None where all have one length.

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
        problem = f"expected {samples} motions of {joints} joints for each of {len(sequence_ids)} sequences"
        raise PredictionsError(f"{path}: {problem}, found others. {remedy}")
    found = rows["joints"].combine_chunks()
    lengths = found.value_lengths().to_numpy()
    values = found.flatten().flatten().to_numpy()
    due = lengths[:1] if n_frames is None else np.tile(n_frames, samples)
    if (lengths != due).any() or not np.isfinite(values).all():
        raise PredictionsError(f"{path}: expected finite motions of the asked length, found others. {remedy}")
    within = np.arange(lengths.max()) < lengths[:, None]
    motions = np.full((*within.shape, joints, 3), np.nan, dtype=values.dtype)
    motions[within] = values.reshape(-1, joints, 3)
    return np.swapaxes(motions.reshape(samples, len(sequence_ids), *motions.shape[1:]), 0, 1)


_CACHED_BYTES = 64 * 1024**2
_JOINTS_FORM = f"a list of frames, each {POSE_SIZE} numbers (22 joints, x y z)"


def index_parquet(paths: tuple[Path, ...]) -> Indexed:
    """Read the ids and samples of one file or several, whose rows count on.

    Raises:
        PredictionsError: if a file cannot be read, or columns are missing or of a wrong kind.
    """
    names = open_part(paths[0]).schema_arrow.names
    id_column = next((name for name in ("sequence_id", "opaque_id") if name in names), None)
    if id_column is None:
        raise PredictionsError(f"{paths[0]}: expected a column 'sequence_id' or 'opaque_id', found {', '.join(names)}.")
    gaze: tuple[str, ...] = ()
    ids: list[str] = []
    samples: list[int] = []
    groups: list[tuple[Path, int, int, int]] = []
    for part in paths:
        file = open_part(part)
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
    return paths, id_column, tuple(ids), tuple(samples), ParquetMotions(tuple(groups), gaze), bool(gaze)


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
        """Return the file that a row stands in, for messages."""
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
            table = open_part(path).read_row_group(group, columns=["joints", *self.gaze])
        rows = _as_rows(table["joints"].combine_chunks(), path, first_row=first_row)
        if self.gaze:
            columns = []
            for name in self.gaze:
                column = table[name].combine_chunks()
                starts, items, _, leaves = _flattened(column)
                is_number = pa.types.is_floating(leaves.type) and not pa.types.is_float16(leaves.type)
                if (items[starts] % 3).any() or not is_number:
                    problem = f"expected x y z for each frame, found {column.type}."
                    raise PredictionsError(f"{path}, column '{name}': {problem}")
                columns.append(_numbers(leaves).reshape(-1, 3))
                offsets = items[starts] // 3
                other = np.flatnonzero(np.diff(offsets) != np.diff(rows.offsets))
                if other.size:
                    row = int(other[0])
                    frames, found = np.diff(rows.offsets)[row], np.diff(offsets)[row]
                    problem = f"expected gaze in each of its {frames} frames, found {found}."
                    raise PredictionsError(f"{path}, row {first_row + row}, column '{name}': {problem}")
            rows = PredictionRows(rows.values, rows.offsets, np.stack(columns, axis=1))
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
            found = f"or all frames after one another (n × {POSE_SIZE} numbers), found {np.diff(rows)[wrong[0]]}"
            raise PredictionsError(f"{where}, row {first_row + wrong[0]}: expected {_JOINTS_FORM}, {found} numbers.")
        return PredictionRows(values.reshape(-1, N_JOINTS, 3), rows // POSE_SIZE)
    if len(sizes) > 1 and (sizes[-1] != 3).any():
        found = int(sizes[-1][sizes[-1] != 3][0])
        raise PredictionsError(f"{where}: expected x y z for each of 22 joints, found {found} numbers.")
    wrong = np.flatnonzero(np.diff(frames) != POSE_SIZE)
    if wrong.size:
        row = int(np.searchsorted(rows, wrong[0], side="right")) - 1
        problem = f"expected {_JOINTS_FORM}, found {np.diff(frames)[wrong[0]]} numbers."
        raise PredictionsError(f"{where}, row {first_row + row}, frame {wrong[0] - rows[row]}: {problem}")
    return PredictionRows(values.reshape(-1, N_JOINTS, 3), rows)


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
        found = f"found another form or a damaged one ({first})."
        remedy = "Write it again as Parquet; parts of a run are made again by the same `prbench run`."
        raise PredictionsError(f"{path}: expected a readable Parquet file, {found} {remedy}") from error


def open_part(path: Path) -> pq.ParquetFile:
    """Open a file of predictions.

    Raises:
        PredictionsError: if it is missing or damaged.
    """
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
        "joints": (is_lists and is_floating, "numbers with decimals (float or double)" if is_lists else _JOINTS_FORM),
        **{name: (_is_list(kinds[name]), "a list of frames") for name in gaze},
    }
    for name, (fits, wanted) in expected.items():
        if not fits:
            raise PredictionsError(f"{path}, column '{name}': expected {wanted}, found {kinds[name]}.")
    return gaze


def _is_list(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or pa.types.is_large_list(kind)


@dataclass(frozen=True)
class Predictions:
    """Finished motions with an index of them.

    Attributes:
        id_column: ``sequence_id`` or ``opaque_id``.
        ids: Id of every motion, in the order of the files.
        has_gaze: True if every motion comes with gaze.
        rows: Row of every motion in the store, where the store holds more motions; None where they are the same.
    """

    paths: tuple[Path, ...]
    id_column: str
    ids: tuple[str, ...]
    samples: tuple[int, ...]
    store: ParquetMotions | ArrayMotions
    has_gaze: bool = False
    rows: Int[np.ndarray, " n"] | None = None

    @classmethod
    @foreign_input()
    def open(cls, path: Path | str) -> Predictions:
        """Index finished motions; those in Parquet are read when they are asked for.

        Args:
            path: A Parquet file or a folder of such (sequence_id or opaque_id, sample, joints), or an ``.npz`` file.

        Raises:
            PredictionsError: if there is none, or it is not of one of these forms.
        """
        path = Path(path)
        if path.is_dir():
            parts = tuple(sorted(part for part in path.glob("*.parquet") if part.name[0] != "."))
            if not parts:
                raise PredictionsError(f"{path}: expected predictions (*.parquet), found none.")
            return cls(*index_parquet(parts))
        if path.suffix.lower() == ".npz":
            return cls(*read_npz(path))
        if path.suffix.lower() != ".parquet" and path.is_file():
            with open_regular(path) as file:
                if file.read(4) != b"PAR1":
                    problem = "expected Parquet, .npz, or a folder of Parquet files, found a file of another kind."
                    remedy = "Pickles and torch files are never loaded: save the arrays with np.savez."
                    raise PredictionsError(f"{path}: {problem} {remedy}")
        return cls(*index_parquet((path,)))

    def only(self, ids: Sequence[str], samples: Sequence[int]) -> Predictions:
        """Return some of the motions, without the index of all others.

        Args:
            ids: Their ids.
            samples: Their samples; every id has each of them.
        """
        keys = [(name, sample) for sample in samples for name in ids]
        places = np.array([self._place(*key) for key in keys], dtype=np.int64)
        rows = places if self.rows is None else self.rows[places]
        ids = tuple(name for name, _ in keys)
        samples = tuple(sample for _, sample in keys)
        if isinstance(self.store, ArrayMotions):
            return replace(self, ids=ids, samples=samples, store=self.store.only(rows.tolist()), rows=None)
        return replace(self, ids=ids, samples=samples, rows=rows)

    @cached_property
    def _place_of(self) -> dict[tuple[str, int], int]:
        """Maps id and sample to the place; of repeated ones to the last."""
        return {key: place for place, key in enumerate(zip(self.ids, self.samples))}

    def _place(self, name: str, sample: int) -> int:
        """Return the place of a motion among all; refuse one that is not there."""
        place = self._place_of.get((name, sample))
        if place is None:
            where = self.paths[0] if len(self.paths) == 1 else self.paths[0].parent
            found = "found none: the row was lost after the motions were written."
            remedy = "Write them again; of a run, delete the file and run the command again."
            raise PredictionsError(f"{where}: expected a motion of {quoted(name)} (sample {sample}), {found} {remedy}")
        return place

    def _row(self, name: str, sample: int) -> int:
        """Return the row of a motion in the store."""
        place = self._place(name, sample)
        return place if self.rows is None else int(self.rows[place])

    def __contains__(self, key: tuple[str, int]) -> bool:
        return key in self._place_of

    def where(self, name: str, sample: int) -> str:
        """Return the file that a motion stands in and its place there, for messages."""
        return self.store.where(self._row(name, sample))

    @foreign_input()
    def motions(self, ids: Sequence[str], sample: int) -> PredictionRows:
        """Return the motions of the given sequences, in the given order; float32, as a run keeps them.

        Raises:
            PredictionsError: if a motion is empty, damaged, a frame does not have 22 joints, or gaze has other frames
                than the joints.
        """
        rows = [self._row(name, sample) for name in ids]
        joints, rays = self.store.motions(rows)
        lengths = [len(motion) for motion in joints]
        if 0 in lengths:
            i = lengths.index(0)
            raise PredictionsError(f"{self.store.where(rows[i])}, {ids[i]}: expected a motion, found no frames.")
        gaze = as_float32(np.concatenate(rays)) if rays else None
        return PredictionRows(as_float32(np.concatenate(joints)), np.concatenate(([0], np.cumsum(lengths))), gaze)
