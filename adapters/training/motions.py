"""Rows of sequence tables and of corpora as motions, cut and mirrored without leaving the canonical frame."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, TableError
from prbench.files.bounded import foreign_input
from prbench.geometry.skeleton import Joint, canonical_frame, invert_rigid, transform_points
from prbench.representation import Mode, encode, mirror
from prbench.sequences import CorpusTable, SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import CORPUS_FILE

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
        yield _rows(chunk, corpus=isinstance(table, CorpusTable))


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


def _rows(chunk: SequenceChunk, *, corpus: bool) -> list[Row]:
    joints = chunk.joints
    offsets = chunk.offsets
    before = chunk.poses("previous_joints")
    after = chunk.poses("next_joints")
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
