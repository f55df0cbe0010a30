"""Rows of tables as motions, and the feature store: features of a table, computed once and memory-mapped from then on.

Motions are cut without leaving the canonical frame. One Arrow IPC file per table, split and way of
encoding lies in prbench's cache folder. It opens in milliseconds, every process that reads it shares its pages, and an
item is a view of it. Files may be deleted at any time: what is missing is made again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.ipc
from jaxtyping import Float, Int

from prbench.engine import IN_PROCESS, Engine
from prbench.errors import InputFileError, TableError
from prbench.files.bounded import foreign_input, require_rows, require_size
from prbench.files.storage import atomic_path, in_turn, read_json, sole_writer, text_digest, write_json
from prbench.geometry.skeleton import N_JOINTS, Joint, canonical_frame, invert_rigid, transform_points
from prbench.limits import LARGEST_ARCHIVE
from prbench.representation import N_FEATURES, Mode, check_joints, encode
from prbench.sequences import CorpusTable, SequenceTable
from prbench.sequences.dataset_info import CORPUS_FILE
from prbench.sequences.sequence import column
from prbench_adapters.training.configuration import DataConfiguration

_SHORTEST_ACROSS = 1e-6  # metres
Table = SequenceTable | CorpusTable


@dataclass(frozen=True)
class Motion:
    """Joints of one clip in its own canonical frame, metres, float32.

    Attributes:
        previous_joints: The frame before the first.
        next_joints: The frame after the last, which the last feature row needs.
        goal_location: NaN where the motion has no goal.
    """

    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"]
    next_joints: Float[np.ndarray, "22 3"]
    goal_location: Float[np.ndarray, "3"]

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
    before = motion.joints[start - 1] if start else motion.previous_joints
    after = motion.joints[stop] if stop < motion.n_frames else motion.next_joints
    parts = (points.astype(np.float64) for points in (kept, before, after, motion.goal_location))
    return Motion(*(transform_points(canonical_from_motion, points).astype(np.float32) for points in parts))


def check_headings(joints: Float[np.ndarray, "n 22 3"], *, name: str, first: int = 0) -> None:
    """Refuse poses that no canonical frame can start with: hips and shoulders on one vertical line.

    Raises:
        InputFileError: naming the motion and the frame, counted from ``first``.
    """
    across = joints[:, Joint.RIGHT_HIP] - joints[:, Joint.LEFT_HIP]
    across = across + joints[:, Joint.RIGHT_SHOULDER] - joints[:, Joint.LEFT_SHOULDER]
    without = np.hypot(across[:, 0], across[:, 2]) < _SHORTEST_ACROSS
    found = "hips and shoulders on one vertical line"
    remedy = "Leave the motion out."
    require_rows(name, without, "a pose with a heading", found, place="frame", first=first, remedy=remedy)


def encoded(motion: Motion, mode: Mode, *, name: str, checked: bool = False) -> Float[np.ndarray, "n 263"]:
    """Raw features, one row a frame, the last one with the step to the motion's own next frame.

    People may lie or crawl: which axis points up was checked when the table was built. A part of a stored row was
    ``checked`` when the store was made.

    Raises:
        InputFileError: if a pose cannot be encoded; it begins with ``name``.
    """
    return encode(motion.joints, next_joints=motion.next_joints, mode=mode, source=name, upright=False, checked=checked)


@dataclass(frozen=True)
class Row:
    """One row of a table, as training uses it.

    Attributes:
        texts: All captions; a sequence of P&R has one.
    """

    sequence_id: str
    texts: tuple[str, ...]
    motion: Motion


@foreign_input()
def open_table(table: Table | Path | str) -> Table:
    """Return a table as it is, or the one that a folder holds, whichever kind it is.

    Raises:
        TableError: if the folder holds neither a dataset nor a corpus, or what it holds cannot be read.
    """
    if isinstance(table, SequenceTable | CorpusTable):
        return table
    folder = Path(table)
    return CorpusTable.open(folder) if (folder / CORPUS_FILE).is_file() else SequenceTable.open(folder).with_sequences()


def read_rows(table: Table, split: str | None) -> Iterator[list[Row]]:
    """Yield the rows of a split, or of all, in the order of the table, some hundred at a time."""
    corpus = isinstance(table, CorpusTable)
    own = ("captions",) if corpus else ("text", "goal_location")
    for chunk in table.chunks(split=split, columns=[*own, "joints", "previous_joints", "next_joints"]):
        before = chunk.poses("previous_joints")
        after = chunk.poses("next_joints")
        if corpus:
            goals = np.full((len(chunk), 3), np.nan)
            captions = chunk.batch.column("captions").to_pylist()
            texts = [tuple(caption["text"] for caption in row) for row in captions]
        else:
            goals = chunk.vectors("goal_location")
            texts = [(text,) for text in chunk.strings("text")]
        rows = []
        for i, name in enumerate(chunk.sequence_ids):
            joints = chunk.joints[chunk.offsets[i] : chunk.offsets[i + 1]]
            rows.append(Row(name, texts[i], Motion(joints, before[i], after[i], goals[i].astype(np.float32))))
        yield rows


# Both splits learnt from together, once nothing is chosen by the validation split any more.
REFIT = "train+validation"


def parts_of(split: str) -> tuple[str, ...]:
    """Return the table's own splits that are meant: two for :data:`REFIT`, otherwise the one itself."""
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
        remedy = "Build it again with one --fps."
        raise TableError(f"{table.folder}: expected one frame rate, found {found} frames per second. {remedy}")
    return float(rates[0])


_POSE = pa.list_(pa.float32(), 3 * N_JOINTS)
# One row a motion. One that is longer than an item may be has no features, because each of its crops has its own.
_COLUMNS = {
    "sequence_id": pa.string(),
    "texts": pa.list_(pa.string()),
    "n_frames": pa.int32(),
    "joints": pa.list_(_POSE),
    "previous_joints": _POSE,
    "next_joints": _POSE,
    "goal_location": pa.list_(pa.float32(), 3),
    "features": pa.list_(pa.list_(pa.float32(), N_FEATURES)),
}
_SCHEMA = pa.schema([pa.field(name, kind, nullable=False) for name, kind in _COLUMNS.items()])


class FeatureStore:
    """A store on disk, opened; it travels to other processes as a path and is opened there again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        require_size(path, largest=LARGEST_ARCHIVE)
        with pa.memory_map(str(path)) as source:  # the batches keep the mapping alive
            self.table = pa.ipc.open_file(source).read_all()
        # The arrays of each record batch by name: views of the mapped file.
        self._blocks: list[dict[str, np.ndarray]] = []
        for batch in self.table.to_batches():
            block = {"n_frames": batch.column("n_frames").to_numpy()}
            for name in ("joints", "previous_joints", "next_joints", "goal_location", "features"):
                vectors = batch.column(name)
                if name in ("joints", "features"):
                    block[f"{name}_offsets"] = vectors.offsets.to_numpy()
                    vectors = vectors.values
                values = vectors.values.to_numpy(zero_copy_only=True).reshape(-1, vectors.type.list_size)
                block[name] = values.reshape(-1, N_JOINTS, 3) if vectors.type == _POSE else values
            self._blocks.append(block)
        self._starts = np.cumsum([0, *(len(block["n_frames"]) for block in self._blocks)])
        self.n_frames: Int[np.ndarray, " rows"] = self.table["n_frames"].to_numpy().astype(np.int64)
        self.sequence_ids: list[str] = self.table["sequence_id"].to_pylist()

    def __len__(self) -> int:
        return len(self.n_frames)

    def texts(self, row: int) -> tuple[str, ...]:
        """All captions of a row."""
        return tuple(self.table["texts"][row].as_py())

    def row(self, row: int) -> tuple[Motion, Float[np.ndarray, "n 263"] | None]:
        """Return the whole motion of a row and its features, which are None for one that has to be cut first.

        Both are views of the file, not to be written to.
        """
        index = int(np.searchsorted(self._starts, row, side="right")) - 1
        block = self._blocks[index]
        place = row - int(self._starts[index])
        parts = {}
        for name in ("joints", "features"):
            first, last = block[f"{name}_offsets"][place : place + 2]
            parts[name] = block[name][first:last]
        others = {name: block[name][place] for name in ("previous_joints", "next_joints", "goal_location")}
        return Motion(joints=parts["joints"], **others), parts["features"] if len(parts["features"]) else None

    def __reduce__(self) -> tuple[type[FeatureStore], tuple[Path]]:
        return FeatureStore, (self.path,)


Crop = Literal["end", "random"]

_VERSION = "1"  # of what is kept; raise it when cutting or the columns change


class LeftOut(msgspec.Struct, frozen=True):
    """A row that training cannot use, and why."""

    sequence_id: str
    reason: str


def table_store(
    table: Table, split: str, encoding: DataConfiguration, cache: Path, *, engine: Engine = IN_PROCESS
) -> tuple[FeatureStore, tuple[LeftOut, ...]]:
    """Open the store of a table; where there is none yet, or the table has changed, make it.

    Args:
        table: The table.
        split: Which of its rows.
        encoding: How they become items; stores of different encodings stand beside each other.
        cache: Folder of the stores.
        engine: Engine that encodes rows; the store has the same bytes for any.

    Returns:
        The opened store, and the rows that are not in it.

    Raises:
        TableError: if none of the rows can be used.
        StorageError: if the store cannot be written.
    """
    # Whatever decides the features is part of the name, so that a stale store is never opened.
    decisive = (split, encoding.mode, encoding.max_frames, encoding.crop)
    digest = text_digest(_VERSION, _representation_digest(), table.info.content_digest, *map(str, decisive))
    path = cache / f"{table.info.dataset}-{split}-{digest[:24]}.arrow"
    found = _opened(path)
    if found is None:
        # Make the store and its notes, unless another process has made them while this one waited for it.
        with in_turn(path), sole_writer(path.with_suffix(".json")):
            found = _opened(path)
            if found is None:
                left_out = _make(table, split, encoding, path, engine)
                write_json(path.with_suffix(".json"), {"left_out": msgspec.to_builtins(left_out)})
                found = _opened(path)
        assert found is not None, "what was just made can be opened"
    return found


def _opened(path: Path) -> tuple[FeatureStore, tuple[LeftOut, ...]] | None:
    """Return a store and the rows that are not in it; None if there is none, or a damaged one to be made again."""
    try:
        notes = msgspec.convert(read_json(path.with_suffix(".json")), dict[str, tuple[LeftOut, ...]])
        return FeatureStore(path), notes["left_out"]
    except (InputFileError, msgspec.ValidationError, KeyError, FileNotFoundError, pa.ArrowInvalid):
        return None


def _representation_digest() -> str:
    """Digest of the source files of the representation: features that other code made are never taken over."""
    digest = hashlib.sha256()
    for file in sorted(resources.files("prbench.representation").iterdir(), key=lambda entry: entry.name):
        if file.name.endswith(".py"):
            digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def _make(table: Table, split: str, encoding: DataConfiguration, path: Path, engine: Engine) -> tuple[LeftOut, ...]:
    """Write the store, and return the rows that are not in it."""
    left_out: list[LeftOut] = []
    kept = 0
    with atomic_path(path) as temporary, pyarrow.ipc.new_file(str(temporary), _SCHEMA) as writer:
        for batch, unusable in engine.map(partial(_encoded_rows, encoding=encoding), read_rows(table, split)):
            left_out += unusable
            if batch.num_rows:
                writer.write_batch(batch)
            kept += batch.num_rows
        if not kept:
            example = f" The first of them: {left_out[0].reason}" if left_out else ""
            found = f"found {len(left_out)} that cannot be used.{example}"
            raise TableError(f"{table.folder}: expected rows of split '{split}' to train on, {found}")
    return tuple(left_out)


def _encoded_rows(rows: list[Row], encoding: DataConfiguration) -> tuple[pa.RecordBatch, list[LeftOut]]:
    """Return the rows of the store for some rows of a table, and those that cannot be used."""
    left_out: list[LeftOut] = []
    stored: list[tuple] = []  # in the order of the columns
    longest = encoding.max_frames
    for row in rows:
        name = row.sequence_id
        motion = row.motion
        try:
            if motion.n_frames > longest and encoding.crop == "end":
                motion = cut(motion, motion.n_frames - longest, longest, name=name)
            if motion.n_frames <= longest:
                features = encoded(motion, encoding.mode, name=name)
            else:
                check_joints(np.concatenate([motion.joints, motion.next_joints[None]]), source=name, upright=False)
                check_headings(motion.joints, name=name)  # any of its frames may become the first
                features = np.empty((0, N_FEATURES), dtype=np.float32)
        except InputFileError as error:
            left_out.append(LeftOut(name, str(error)))
            continue
        joints = motion.joints.reshape(motion.n_frames, -1)
        beside = (motion.previous_joints, motion.next_joints, motion.goal_location)
        stored.append((name, list(row.texts), motion.n_frames, joints, *beside, features))
    arrays = [column([row[place] for row in stored], kind) for place, kind in enumerate(_COLUMNS.values())]
    return pa.RecordBatch.from_arrays(arrays, schema=_SCHEMA), left_out
