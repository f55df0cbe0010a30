"""Rows of tables as motions, and the feature store: features of a table, computed once and memory-mapped from then on.

Motions are cut and mirrored without leaving the canonical frame. One Arrow IPC file per table, split and way of
encoding lies in prbench's cache folder. It opens in milliseconds, every process that reads it shares its pages, and an
item is a view of it. Files may be deleted at any time: what is missing is made again.
"""

from __future__ import annotations

import hashlib
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.ipc
from jaxtyping import Float, Int

from prbench.engine import Engine, InProcess
from prbench.errors import InputFileError, TableError
from prbench.files.bounded import foreign_input
from prbench.files.storage import atomic_path, in_turn, read_json, sole_writer, text_digest, write_json
from prbench.geometry.skeleton import N_JOINTS, Joint, canonical_frame, invert_rigid, transform_points
from prbench.representation import N_FEATURES, Mode, check_joints, encode, mirror
from prbench.sequences import CorpusTable, SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import CORPUS_FILE
from prbench.sequences.schema import table_parts
from prbench.sequences.sequence import column
from prbench_adapters.training.configuration import DataConfiguration

_LEFT_RIGHT = re.compile(r"\b(left|right)", re.IGNORECASE)
_SHORTEST_ACROSS = 1e-6  # metres
Table = SequenceTable | CorpusTable
_MOTION = ("joints", "previous_joints", "next_joints")


@dataclass(frozen=True)
class Motion:
    """Joints of one clip in its own canonical frame, metres, float32."""

    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"]
    """The frame before the first."""
    next_joints: Float[np.ndarray, "22 3"]
    """The frame after the last, which the last feature row needs."""
    goal_location: Float[np.ndarray, "3"]
    """NaN where the motion has no goal."""

    @property
    def n_frames(self) -> int:
        """Frames of the motion itself."""
        return len(self.joints)


def cut(motion: Motion, start: int, n_frames: int, *, name: str) -> Motion:
    """Frames ``start`` to ``start + n_frames``, in the canonical frame of the first one kept.

    The frames next to the cut become the neighbours, so initial velocity and last feature row stay true; the goal moves
    along. The lowest joint of the kept frames stands on Y = 0, as that of a table's row does.

    Raises:
        InputFileError: if the first kept pose has no heading; it begins with ``name``.
    """
    stop = start + n_frames
    assert start >= 0
    assert stop <= motion.n_frames
    # float64, because moving to another frame and back would else drift by micrometres.
    kept = motion.joints[start:stop].astype(np.float64)
    check_headings(kept[:1], name=name, first=start)
    canonical_from_motion = invert_rigid(canonical_frame(kept))

    def moved(points: np.ndarray) -> np.ndarray:
        return transform_points(canonical_from_motion, points.astype(np.float64)).astype(np.float32)

    return Motion(
        joints=moved(kept),
        previous_joints=moved(motion.joints[start - 1] if start else motion.previous_joints),
        next_joints=moved(motion.joints[stop] if stop < motion.n_frames else motion.next_joints),
        goal_location=moved(motion.goal_location),
    )


def check_headings(joints: Float[np.ndarray, "n 22 3"], *, name: str, first: int = 0) -> None:
    """Refuse poses that no canonical frame can start with: hips and shoulders on one vertical line.

    Raises:
        InputFileError: naming the motion and the frame, counted from ``first``.
    """
    across = joints[:, Joint.RIGHT_HIP] - joints[:, Joint.LEFT_HIP]
    across = across + joints[:, Joint.RIGHT_SHOULDER] - joints[:, Joint.LEFT_SHOULDER]
    without = np.flatnonzero(np.hypot(across[:, 0], across[:, 2]) < _SHORTEST_ACROSS)
    if without.size:
        raise InputFileError(
            name,
            f"frame {first + int(without[0])}",
            expected="a pose with a heading",
            found="hips and shoulders on one vertical line",
            remedy="Leave the motion out.",
        )


def encoded(motion: Motion, mode: Mode, *, name: str) -> Float[np.ndarray, "n 263"]:
    """Raw features, one row a frame, the last one with the step to the motion's own next frame.

    People may lie or crawl: which axis points up was checked when the table was built.

    Raises:
        InputFileError: if a pose cannot be encoded; it begins with ``name``.
    """
    return encode(motion.joints, next_joints=motion.next_joints, mode=mode, source=name, upright=False)


def mirrored(motion: Motion) -> Motion:
    """The motion as a mirror shows it: x negated, left and right limbs exchanged; still in its canonical frame."""
    return Motion(
        joints=mirror(motion.joints),
        previous_joints=mirror(motion.previous_joints),
        next_joints=mirror(motion.next_joints),
        goal_location=motion.goal_location * np.array([-1, 1, 1], dtype=np.float32),
    )


def mirrored_text(text: str) -> str:
    """A caption with its words left and right exchanged, capital letters kept."""

    def exchanged(match: re.Match[str]) -> str:
        word = match[1]
        other = "right" if word.lower() == "left" else "left"
        if word.isupper():
            return other.upper()
        return other.capitalize() if word[0].isupper() else other

    return _LEFT_RIGHT.sub(exchanged, text)


@dataclass(frozen=True)
class Row:
    """One row of a table, as training uses it."""

    sequence_id: str
    texts: tuple[str, ...]
    """All captions; a sequence of P&R has one."""
    motion: Motion


@foreign_input()
def open_table(table: Table | Path | str) -> Table:
    """A table as it is, or the one that a folder holds, whichever kind it is.

    Raises:
        TableError: if the folder holds neither a dataset nor a corpus, or what it holds cannot be read.
    """
    if isinstance(table, SequenceTable | CorpusTable):
        return table
    folder = Path(table)
    return CorpusTable.open(folder) if (folder / CORPUS_FILE).is_file() else SequenceTable.open(folder).with_sequences()


def read_rows(table: Table, split: str) -> Iterator[list[Row]]:
    """The rows of a split in the order of the table, some hundred at a time."""
    own = ("captions",) if isinstance(table, CorpusTable) else ("text", "goal_location")
    for chunk in table.chunks(split=split, columns=[*own, *_MOTION]):
        corpus = isinstance(table, CorpusTable)
        joints = chunk.joints
        offsets = chunk.offsets
        before = chunk.poses("previous_joints")
        after = chunk.poses("next_joints")
        goals = np.full((len(chunk), 3), np.nan) if corpus else chunk.vectors("goal_location")
        texts = _captions(chunk) if corpus else [(text,) for text in chunk.strings("text")]
        yield [
            Row(
                name,
                texts[i],
                Motion(joints[offsets[i] : offsets[i + 1]], before[i], after[i], goals[i].astype(np.float32)),
            )
            for i, name in enumerate(chunk.sequence_ids)
        ]


REFIT = "train+validation"
"""Both splits learnt from together, once nothing is chosen by the validation split any more."""


def parts_of(split: str) -> tuple[str, ...]:
    """The table's own splits that are meant: two for :data:`REFIT`, otherwise the one itself."""
    return tuple(split.split("+"))


def frame_rate(table: Table, split: str) -> float:
    """Frames per second of all rows of a split, which may be :data:`REFIT`.

    Raises:
        TableError: if the split has no rows, or rows of several rates.
    """
    scalars = table.scalars(columns=["split", "fps"])
    splits = np.array(scalars["split"].to_pylist())
    rates = np.unique(scalars["fps"].to_numpy()[np.isin(splits, parts_of(split))])
    if not len(rates):
        found = ", ".join(f"{np.sum(splits == name)} of '{name}'" for name in sorted(set(splits)))
        raise TableError(f"{table.folder}: expected rows of split '{split}', found {found}.")
    if len(rates) > 1:
        found = ", ".join(f"{rate:g}" for rate in rates)
        raise TableError(
            f"{table.folder}: expected one frame rate, found {found} frames per second. Build it again with one --fps."
        )
    return float(rates[0])


def holds_mirrored(table: Table) -> bool:
    """Return True for a corpus that brings mirrored copies of its own."""
    return isinstance(table, CorpusTable) and bool(np.any(table.scalars(columns=["mirrored"])["mirrored"].to_numpy()))


def _captions(chunk: SequenceChunk) -> list[tuple[str, ...]]:
    captions = chunk.batch.column("captions").to_pylist()
    return [tuple(caption["text"] for caption in row) for row in captions]


_POSE = pa.list_(pa.float32(), 3 * N_JOINTS)

STORE = pa.schema(
    [
        pa.field("sequence_id", pa.string(), nullable=False),
        pa.field("texts", pa.list_(pa.string()), nullable=False),
        pa.field("n_frames", pa.int32(), nullable=False),
        pa.field("joints", pa.list_(_POSE), nullable=False),
        pa.field("previous_joints", _POSE, nullable=False),
        pa.field("next_joints", _POSE, nullable=False),
        pa.field("goal_location", pa.list_(pa.float32(), 3), nullable=False),
        pa.field("features", pa.list_(pa.list_(pa.float32(), N_FEATURES)), nullable=False),
    ]
)
"""One row a motion. One that is longer than an item may be has no features, because each of its crops has its own."""


class FeatureStore:
    """A store on disk, opened; it travels to other processes as a path and is opened there again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._open()

    def __len__(self) -> int:
        return len(self.n_frames)

    def sequence_id(self, row: int) -> str:
        """The id of a row; that of a mirrored copy ends with ``#mirrored``."""
        block, place = self._at(row)
        return block.batch.column("sequence_id")[place].as_py()

    def texts(self, row: int) -> tuple[str, ...]:
        """All captions of a row."""
        block, place = self._at(row)
        return tuple(block.batch.column("texts")[place].as_py())

    def motion(self, row: int) -> Motion:
        """The whole motion of a row: views of the file, not to be written to."""
        block, place = self._at(row)
        return Motion(
            joints=block.joints[block.joint_offsets[place] : block.joint_offsets[place + 1]],
            previous_joints=block.previous_joints[place],
            next_joints=block.next_joints[place],
            goal_location=block.goal_location[place],
        )

    def features(self, row: int) -> Float[np.ndarray, "n 263"] | None:
        """Features of a row, a view of the file; None for a motion that has to be cut first."""
        block, place = self._at(row)
        start, stop = block.feature_offsets[place : place + 2]
        return block.features[start:stop] if stop > start else None

    def _open(self) -> None:
        with pa.memory_map(str(self.path)) as source:  # the batches keep the mapping alive
            reader = pa.ipc.open_file(source)
            self._blocks = [_Block.of(reader.get_batch(i)) for i in range(reader.num_record_batches)]
        counts = [block.batch.num_rows for block in self._blocks]
        self._starts = np.concatenate(([0], np.cumsum(counts)))
        # An empty store has no blocks, and concatenate needs at least one array.
        lengths = [block.batch.column("n_frames").to_numpy() for block in self._blocks]
        self.n_frames: Int[np.ndarray, " rows"] = np.concatenate([np.empty(0, np.int32), *lengths]).astype(np.int64)

    def _at(self, row: int) -> tuple[_Block, int]:
        if not 0 <= row < len(self):
            raise IndexError(f"row {row} of {len(self)}")
        index = int(np.searchsorted(self._starts, row, side="right")) - 1
        return self._blocks[index], int(row - self._starts[index])

    def __getstate__(self) -> dict[str, Path]:
        return {"path": self.path}

    def __setstate__(self, state: dict[str, Path]) -> None:
        self.path = state["path"]
        self._open()


@dataclass(frozen=True)
class _Block:
    """The arrays of one record batch: views of the mapped file."""

    batch: pa.RecordBatch
    joints: np.ndarray
    joint_offsets: np.ndarray
    features: np.ndarray
    feature_offsets: np.ndarray
    previous_joints: np.ndarray
    next_joints: np.ndarray
    goal_location: np.ndarray

    @classmethod
    def of(cls, batch: pa.RecordBatch) -> _Block:
        joints = batch.column("joints")
        features = batch.column("features")
        return cls(
            batch,
            _values(joints.values).reshape(-1, N_JOINTS, 3),
            joints.offsets.to_numpy(),
            _values(features.values),
            features.offsets.to_numpy(),
            _values(batch.column("previous_joints")).reshape(-1, N_JOINTS, 3),
            _values(batch.column("next_joints")).reshape(-1, N_JOINTS, 3),
            _values(batch.column("goal_location")),
        )


def _values(vectors: pa.FixedSizeListArray) -> np.ndarray:
    return vectors.values.to_numpy(zero_copy_only=True).reshape(-1, vectors.type.list_size)


Crop = Literal["end", "random"]

_IN_PROCESS = InProcess()
_VERSION = "1"  # of what is kept; raise it when cutting, mirroring or the columns change
_ABANDONED_S = 3600.0
"""A half-written file that nobody wrote to for so long was left by a process that was killed."""


class LeftOut(msgspec.Struct, frozen=True):
    """A row that training cannot use, and why."""

    sequence_id: str
    reason: str


def table_store(
    table: Table, split: str, encoding: DataConfiguration, cache: Path, *, engine: Engine = _IN_PROCESS
) -> tuple[FeatureStore, tuple[LeftOut, ...]]:
    """Open the store of a table; where there is none yet, or the table has changed, make it.

    Args:
        table: The table.
        split: Which of its rows.
        encoding: How they become items; stores of different encodings stand beside each other.
        cache: Folder of the stores.
        engine: Where rows are encoded; the store has the same bytes for any.

    Returns:
        The opened store, and the rows that are not in it.

    Raises:
        TableError: if the rows are not those that the table's own description promises, or none of them can be used.
        StorageError: if the store cannot be written.
    """
    path = cache / f"{_key(table, split, encoding)}.arrow"
    found = _opened(path)
    if found is None:
        # Make the store and its notes, unless another process has made them while this one waited for it.
        with in_turn(path), sole_writer(path.with_suffix(".json")):
            found = _opened(path)
            if found is None:
                _make(table, split, encoding, path, engine)
                found = _opened(path)
        assert found is not None, "what was just made can be opened"
    notes, store = found
    if notes.files != _files(table):
        _require_unchanged(table)  # another copy of the same table is welcome
    return store, notes.left_out


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


def _key(table: Table, split: str, encoding: DataConfiguration) -> str:
    parts = (split, encoding.mode, encoding.max_frames, encoding.crop, encoding.mirrored)
    # Whatever decides the features is part of the name, so that a stale store is never opened.
    digest = text_digest(_VERSION, _representation_digest(), table.info.content_digest, *map(str, parts))
    return f"{table.info.dataset}-{split}-{digest[:24]}"


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


def _make(table: Table, split: str, encoding: DataConfiguration, path: Path, engine: Engine) -> None:
    files = _files(table)
    _require_unchanged(table)
    # Delete what killed processes left half-written; other processes may be writing theirs right now.
    for left in path.parent.glob(".*.partial.arrow") if path.parent.is_dir() else ():
        if time.time() - left.stat().st_mtime > _ABANDONED_S:
            left.unlink(missing_ok=True)
    left_out: list[LeftOut] = []
    kept = 0
    with atomic_path(path) as temporary, pyarrow.ipc.new_file(str(temporary), STORE) as writer:
        for batch, unusable in engine.map(_Encoder(encoding), read_rows(table, split)):
            left_out += unusable
            if batch.num_rows:
                writer.write_batch(batch)
            kept += batch.num_rows
        if not kept:
            example = f" The first of them: {left_out[0].reason}" if left_out else ""
            raise TableError(
                f"{table.folder}: expected rows of split '{split}' to train on,"
                f" found {len(left_out)} that cannot be used.{example}"
            )
        write_json(path.with_suffix(".json"), msgspec.to_builtins(_Notes(files, tuple(left_out))))


@dataclass(frozen=True)
class _Encoder:
    """Encodes some rows of a table; goes to a worker as it is."""

    encoding: DataConfiguration

    def __call__(self, rows: list[Row]) -> tuple[pa.RecordBatch, list[LeftOut]]:
        """Return the rows of the store, and those that cannot be used."""
        left_out: list[LeftOut] = []
        return _encoded_rows(rows, self.encoding, left_out), left_out


def _encoded_rows(rows: list[Row], encoding: DataConfiguration, left_out: list[LeftOut]) -> pa.RecordBatch:
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


def _versions(row: Row, encoding: DataConfiguration) -> list[Row]:
    """The row as items will show it, cut to its end where that is asked for, and its mirrored copy."""
    motion = row.motion
    longest = encoding.max_frames
    if motion.n_frames > longest and encoding.crop == "end":
        row = Row(row.sequence_id, row.texts, cut(motion, motion.n_frames - longest, longest, name=row.sequence_id))
    if not encoding.mirrored:
        return [row]
    texts = tuple(mirrored_text(text) for text in row.texts)
    return [row, Row(f"{row.sequence_id}#mirrored", texts, mirrored(row.motion))]


def _features(row: Row, encoding: DataConfiguration) -> np.ndarray:
    """Features of a motion that is not longer than an item may be; none of a longer one, whose crops are encoded."""
    if row.motion.n_frames <= encoding.max_frames:
        return encoded(row.motion, encoding.mode, name=row.sequence_id)
    check_joints(row.motion.joints, source=row.sequence_id, upright=False)
    check_headings(row.motion.joints, name=row.sequence_id)  # any of its frames may become the first
    return np.empty((0, N_FEATURES), dtype=np.float32)
