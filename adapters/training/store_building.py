"""Make the feature store of a table, or find the one that was made before."""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.ipc

from prbench.engine import Engine, InProcess
from prbench.errors import InputFileError, TableError
from prbench.files.storage import atomic_path, in_turn, read_json, sole_writer, text_digest, write_json
from prbench.representation import N_FEATURES, Mode, check_joints
from prbench.sequences import CorpusTable
from prbench.sequences.schema import table_parts
from prbench.sequences.sequence import column
from prbench_adapters.training.feature_store import STORE, FeatureStore
from prbench_adapters.training.motions import (
    Row,
    Table,
    check_headings,
    cut,
    encoded,
    mirrored,
    mirrored_text,
    read_rows,
)

Crop = Literal["end", "random"]

_IN_PROCESS = InProcess()
_VERSION = "1"  # of what is kept; raise it when cutting, mirroring or the columns change
_ABANDONED_S = 3600.0
"""A half-written file that nobody wrote to for so long was left by a process that was killed."""


class LeftOut(msgspec.Struct, frozen=True):
    """A row that training cannot use, and why."""

    sequence_id: str
    reason: str


@dataclass(frozen=True)
class Encoding:
    """Settings by which rows become items; stores of different encodings stand beside each other."""

    split: str
    mode: Mode
    max_frames: int
    crop: Crop
    mirrored: bool


def table_store(
    table: Table, encoding: Encoding, cache: Path, *, engine: Engine = _IN_PROCESS
) -> tuple[FeatureStore, tuple[LeftOut, ...]]:
    """Open the store of a table; where there is none yet, or the table has changed, make it.

    Args:
        table: The table.
        encoding: How its rows become items.
        cache: Folder of the stores.
        engine: Where rows are encoded; the store has the same bytes for any.

    Returns:
        The opened store, and the rows that are not in it.

    Raises:
        TableError: if the rows are not those that the table's own description promises, or none of them can be used.
        StorageError: if the store cannot be written.
    """
    path = cache / f"{_key(table, encoding)}.arrow"
    found = _opened(path)
    if found is None:
        found = _made_once(table, encoding, path, engine)
    notes, store = found
    if notes.files != _files(table):
        _require_unchanged(table)  # another copy of the same table is welcome
    return store, notes.left_out


def _made_once(table: Table, encoding: Encoding, path: Path, engine: Engine) -> tuple[_Notes, FeatureStore]:
    """Make the store and its notes, unless another process has made them while this one waited for it."""
    with in_turn(path), sole_writer(path.with_suffix(".json")):
        found = _opened(path)
        if found is None:
            _make(table, encoding, path, engine)
            found = _opened(path)
    assert found is not None, "what was just made can be opened"
    return found


class _Notes(msgspec.Struct, frozen=True):
    """Notes on a store, kept beside its rows."""

    files: list[tuple[int, int]]
    """Size and time of change of the table's files when the store was made."""
    left_out: tuple[LeftOut, ...]


def _opened(path: Path) -> tuple[_Notes, FeatureStore] | None:
    """A store and its notes; None if there is none, or it is damaged and has to be made again."""
    try:
        notes = msgspec.convert(read_json(path.with_suffix(".json")), _Notes)
        return notes, FeatureStore(path)
    except (InputFileError, msgspec.ValidationError, FileNotFoundError, pa.ArrowInvalid):
        return None


def _files(table: Table) -> list[tuple[int, int]]:
    name = "clips" if isinstance(table, CorpusTable) else "sequences"
    return [(path.stat().st_size, path.stat().st_mtime_ns) for path in table_parts(table.folder, name)]


def _key(table: Table, encoding: Encoding) -> str:
    parts = (encoding.split, encoding.mode, encoding.max_frames, encoding.crop, encoding.mirrored)
    # Whatever decides the features is part of the name, so that a stale store is never opened.
    digest = text_digest(_VERSION, _representation_digest(), table.info.content_digest, *map(str, parts))
    return f"{table.info.dataset}-{encoding.split}-{digest[:24]}"


def _representation_digest() -> str:
    """Digest of the source files of the representation: features that other code made are never taken over."""
    digest = hashlib.sha256()
    for file in sorted(resources.files("prbench.representation").iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".py"):
            digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _require_unchanged(table: Table) -> None:
    """Refuse a table whose rows are not those of its own description.

    Raises:
        TableError: naming it.
    """
    _ = table.content


def _make(table: Table, encoding: Encoding, path: Path, engine: Engine) -> None:
    files = _files(table)
    _require_unchanged(table)
    _remove_abandoned(path.parent)
    left_out: list[LeftOut] = []
    kept = 0
    with atomic_path(path) as temporary, pyarrow.ipc.new_file(str(temporary), STORE) as writer:
        for batch, unusable in engine.map(_Encoder(encoding), read_rows(table, encoding.split)):
            left_out += unusable
            if batch.num_rows:
                writer.write_batch(batch)
            kept += batch.num_rows
        if not kept:
            example = f" The first of them: {left_out[0].reason}" if left_out else ""
            raise TableError(
                f"{table.folder}: expected rows of split '{encoding.split}' to train on,"
                f" found {len(left_out)} that cannot be used.{example}"
            )
        write_json(path.with_suffix(".json"), msgspec.to_builtins(_Notes(files, tuple(left_out))))


@dataclass(frozen=True)
class _Encoder:
    """Encodes some rows of a table; goes to a worker as it is."""

    encoding: Encoding

    def __call__(self, rows: list[Row]) -> tuple[pa.RecordBatch, list[LeftOut]]:
        """Return the rows of the store, and those that cannot be used."""
        left_out: list[LeftOut] = []
        return _encoded_rows(rows, self.encoding, left_out), left_out


def _encoded_rows(rows: list[Row], encoding: Encoding, left_out: list[LeftOut]) -> pa.RecordBatch:
    """The rows of the store for some rows of a table; those that cannot be used are noted instead."""
    stored: list[tuple[Row, np.ndarray]] = []
    for row in rows:
        try:
            stored += [(each, _features(each, encoding)) for each in _versions(row, encoding)]
        except InputFileError as error:
            left_out.append(LeftOut(row.sequence_id, str(error)))
    motions = [row.motion for row, _ in stored]
    columns: dict[str, list] = {
        "sequence_id": [row.sequence_id for row, _ in stored],
        "texts": [list(row.texts) for row, _ in stored],
        "n_frames": [motion.n_frames for motion in motions],
        "joints": [motion.joints.reshape(motion.n_frames, -1) for motion in motions],
        "previous_joints": [motion.previous_joints for motion in motions],
        "next_joints": [motion.next_joints for motion in motions],
        "goal_location": [motion.goal_location for motion in motions],
        "features": [features for _, features in stored],
    }
    return pa.RecordBatch.from_arrays([column(columns[field.name], field.type) for field in STORE], schema=STORE)


def _versions(row: Row, encoding: Encoding) -> list[Row]:
    """The row as items will show it, cut to its end where that is asked for, and its mirrored copy."""
    motion = row.motion
    longest = encoding.max_frames
    if motion.n_frames > longest and encoding.crop == "end":
        row = Row(row.sequence_id, row.texts, cut(motion, motion.n_frames - longest, longest, name=row.sequence_id))
    if not encoding.mirrored:
        return [row]
    texts = tuple(mirrored_text(text) for text in row.texts)
    return [row, Row(f"{row.sequence_id}#mirrored", texts, mirrored(row.motion))]


def _features(row: Row, encoding: Encoding) -> np.ndarray:
    """Features of a motion that is not longer than an item may be; none of a longer one, whose crops are encoded."""
    if row.motion.n_frames <= encoding.max_frames:
        return encoded(row.motion, encoding.mode, name=row.sequence_id)
    check_joints(row.motion.joints, source=row.sequence_id, upright=False)
    check_headings(row.motion.joints, name=row.sequence_id)  # any of its frames may become the first
    return np.empty((0, N_FEATURES), dtype=np.float32)


def _remove_abandoned(cache: Path) -> None:
    """Delete what killed processes left half-written; other processes may be writing theirs right now."""
    for left in cache.glob(".*.partial.arrow") if cache.is_dir() else ():
        if time.time() - left.stat().st_mtime > _ABANDONED_S:
            left.unlink(missing_ok=True)
