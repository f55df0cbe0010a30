"""Rows of sequence tables and of corpora in one form, for training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.boundary import foreign_input
from prbench.errors import TableError
from prbench.sequences import CorpusTable, SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import CORPUS_FILE
from prbench.training.motion import Motion

Table = SequenceTable | CorpusTable

_MOTION = ("joints", "previous_joints", "next_joints")


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
        yield _rows(chunk, corpus=isinstance(table, CorpusTable))


def frame_rate(table: Table, split: str) -> float:
    """Frames per second of all rows of a split.

    Raises:
        TableError: if the split has no rows, or rows of several rates.
    """
    scalars = table.scalars()
    splits = np.array(scalars["split"].to_pylist())
    rates = np.unique(scalars["fps"].to_numpy()[splits == split])
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
    """Whether a corpus brings mirrored copies of its own."""
    return isinstance(table, CorpusTable) and bool(np.any(table.scalars()["mirrored"].to_numpy()))


def _rows(chunk: SequenceChunk, *, corpus: bool) -> list[Row]:
    joints, offsets = chunk.joints, chunk.offsets
    before, after = chunk.poses("previous_joints"), chunk.poses("next_joints")
    goals = np.full((len(chunk), 3), np.nan) if corpus else chunk.vectors("goal_location")
    texts = _captions(chunk) if corpus else [(text,) for text in chunk.strings("text")]
    return [
        Row(
            name,
            texts[i],
            Motion(joints[offsets[i] : offsets[i + 1]], before[i], after[i], goals[i].astype(np.float32)),
        )
        for i, name in enumerate(chunk.sequence_ids)
    ]


def _captions(chunk: SequenceChunk) -> list[tuple[str, ...]]:
    captions = chunk.batch.column("captions").to_pylist()
    return [tuple(caption["text"] for caption in row) for row in captions]
