"""The sequences that are run, and their batches: decided by the sorted table alone."""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Iterable, Iterator
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import numpy as np
import pyarrow as pa
from jaxtyping import Int

from prbench.errors import TableError, UsageError
from prbench.files.storage import text_digest
from prbench.harness.methods.motions import native_frames
from prbench.sequences import SPLITS, SequenceChunk, SequenceTable, by_share

# Sequences, in table order, among which batches of similar length are formed, and which are scored together: small
# enough for memory, large enough that little is padded.
WINDOW = 1024

Table = TypeVar("Table")
Chosen = TypeVar("Chosen", bound="Selection")
_ROWS_AT_ONCE = 4096  # of short columns
_FEWEST_FRAMES = 2  # below which there is no motion


@dataclass(frozen=True)
class Selection:
    """The chosen sequences of one table, in table order (sorted by id)."""

    table: Any
    split: str
    sequence_ids: tuple[str, ...]
    n_frames: Int[np.ndarray, " n"]
    recording_ids: tuple[str, ...]
    fps: float

    def __len__(self) -> int:
        return len(self.sequence_ids)

    @property
    def digest(self) -> str:
        """Over the chosen ids."""
        return text_digest(*self.sequence_ids)

    def chosen(self, keep: np.ndarray) -> Self:
        """Return the rows where ``keep`` is true."""
        return rows_of(self, np.flatnonzero(keep))

    def windows(self, columns: list[str], *, rows: int | None = None) -> Iterator[tuple[slice, SequenceChunk]]:
        """Stream the chosen rows, some at a time, with their places in the selection.

        Args:
            columns: What the chunks hold.
            rows: Number of rows of each chunk but the last; :data:`WINDOW` by default.
        """
        size = rows or WINDOW
        pending: list[pa.RecordBatch] = []
        start = 0
        found = 0
        for chunk in self.table.chunks(split=self.split, columns=columns, ids=self.sequence_ids):
            pending.append(chunk.batch)
            found += len(chunk)
            # Windows count chosen rows, not rows of the file, so the layout of the table leaves no trace.
            while found >= size:
                last = pending.pop()
                within = size - sum(batch.num_rows for batch in pending)
                window = _joined([*pending, last.slice(0, within)])  # shares no memory with the rest
                pending = [last.slice(within)] if within < last.num_rows else []
                found = found - size
                yield slice(start, start + size), SequenceChunk(window)
                del window  # before the next one is read
                start = start + size
        if found:
            yield slice(start, start + found), SequenceChunk(_joined(pending))


def rows_of(table: Table, rows: SequenceOf[int] | np.ndarray) -> Table:
    """Return some rows of a data class whose tuples and arrays hold one entry a row, in the order given."""
    chosen = np.asarray(rows, dtype=np.int64)
    changed: dict[str, Any] = {}
    for field in dataclasses.fields(cast(Any, table)):
        values = getattr(table, field.name)
        if isinstance(values, tuple):
            changed[field.name] = tuple(values[row] for row in chosen)
        elif isinstance(values, np.ndarray):
            changed[field.name] = values[chosen]
    return dataclasses.replace(cast(Any, table), **changed)


def open_tables(folders: Iterable[Path]) -> list[SequenceTable]:
    """Open the tables that are asked for.

    Raises:
        TableError: if one is missing, empty or of an unknown version.
        UsageError: if two are of one dataset.
    """
    return of_distinct_datasets([SequenceTable.open(folder).with_sequences() for folder in folders])


def of_distinct_datasets(tables: list[Any]) -> list[Any]:
    """Return the tables of one run.

    Raises:
        UsageError: if two are of one dataset.
    """
    names = [table.info.dataset for table in tables]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise UsageError(f"--data: expected different datasets, found {repeated[0]} more than once.")
    return tables


def select(table: SequenceTable, *, split: str, limit: int | None) -> Selection:
    """Choose the sequences of a split; with ``limit`` every recording's share (:func:`by_share`).

    Args:
        table: The table.
        split: The split.
        limit: Number of sequences at most; None for all.

    Raises:
        UsageError: for an unknown split or a limit below one.
        TableError: if the split is empty, the table is not sorted, repeats an id or mixes frame rates, or must not be
            scored.
    """
    if split not in SPLITS:
        raise UsageError(f"unknown split '{split}'; the splits are: {', '.join(SPLITS)}.")
    if limit is not None and limit < 1:
        raise UsageError(f"--limit: expected 1 or more sequences, found {limit}.")
    if table.info.why_not_scored is not None:
        raise TableError(f"{table.folder}: cannot be scored: {table.info.why_not_scored}.")
    ids: list[str] = []
    recordings: list[str] = []
    lengths: list[np.ndarray] = []
    rates: set[float] = set()
    for chunk in table.chunks(split=split, columns=["recording_id", "fps"], rows=_ROWS_AT_ONCE):
        # Interned: predictions and scores name the same sequences, and each name is kept once.
        ids += map(sys.intern, chunk.sequence_ids)
        recordings += map(sys.intern, chunk.strings("recording_id"))
        lengths.append(chunk.n_frames)
        rates |= set(np.unique(chunk.numbers("fps")).tolist())
    if not ids:
        splits = table.scalars(columns=["split"])["split"].to_pylist()
        counts = ", ".join(f"{name} {splits.count(name)}" for name in SPLITS)
        remedy = "Build more recordings, or choose another split with --split."
        raise TableError(f"{table.folder}: expected sequences in split '{split}', found none ({counts}). {remedy}")
    # Sorted ids make batches, and so the bytes of a run, independent of how the table was built.
    if any(first >= second for first, second in itertools.pairwise(ids)):
        raise TableError(f"{table.folder}: expected rows sorted by a unique sequence_id. Build the dataset again.")
    n_frames = np.concatenate(lengths)
    if (n_frames < _FEWEST_FRAMES).any():
        found = f"expected {_FEWEST_FRAMES} frames or more, found {n_frames.min()}"
        raise TableError(f"{table.folder}, {ids[int(n_frames.argmin())]}: {found}. Build the dataset again.")
    if len(rates) > 1:
        raise TableError(f"{table.folder}: expected one frame rate, found {sorted(rates)}. Build the dataset again.")
    return limited(Selection(table, split, tuple(ids), n_frames, tuple(recordings), rates.pop()), limit)


def limited(selection: Chosen, limit: int | None) -> Chosen:
    """Return some of the cases, of every recording its share; all without a limit."""
    if limit is None:
        return selection
    kept = set(by_share(selection.sequence_ids, selection.recording_ids)[:limit])
    return selection.chosen(np.array([name in kept for name in selection.sequence_ids]))


def supported(selection: Selection, *, max_frames: int | None, native_fps: float | None) -> Selection:
    """Return the sequences that a method can generate in full; none is ever cut.

    Args:
        selection: The chosen sequences.
        max_frames: The method's limit, at its own rate; None for none.
        native_fps: The method's own rate; None for the table's.
    """
    if max_frames is None:
        return selection
    n_frames = selection.n_frames
    if native_fps is not None:
        n_frames = native_frames(n_frames, fps=selection.fps, native_fps=native_fps)
    return selection.chosen(n_frames <= max_frames)


def consecutive(n: int, size: int) -> list[Int[np.ndarray, "_"]]:
    """Return the places of cases that are batched one after the other, in the order of the table."""
    return [np.arange(start, min(start + size, n)) for start in range(0, n, size)]


def plan_batches(n_frames: Int[np.ndarray, " n"], batch_size: int) -> list[Int[np.ndarray, "_"]]:
    """Rows of each batch: within each window by length, so that little is padded; ties by place in the table.

    Raises:
        UsageError: for a batch size below one.
    """
    if batch_size < 1:
        raise UsageError(f"--batch-size: expected 1 or more, found {batch_size}.")
    batches = []
    for start in range(0, len(n_frames), WINDOW):
        # A stable sort leaves ties in the order of the table, so the plan is the same on every machine.
        order = start + np.argsort(n_frames[start : start + WINDOW], kind="stable")
        batches += [order[i : i + batch_size] for i in range(0, len(order), batch_size)]
    return batches


def plan_digest(sequence_ids: tuple[str, ...], batches: SequenceOf[Int[np.ndarray, "_"]]) -> str:
    """Over the ids of every batch, in order."""
    return text_digest(*(text_digest(*(sequence_ids[row] for row in batch)) for batch in batches))


def _joined(batches: list[pa.RecordBatch]) -> pa.RecordBatch:
    return pa.Table.from_batches(batches).combine_chunks().to_batches()[0]
