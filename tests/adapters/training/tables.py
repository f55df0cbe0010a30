"""Small made-up tables for the tests of training data: sequences, and a corpus with several captions a clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from prbench.sequences import CorpusTable, Sequence, SequenceTable
from prbench.sequences.corpus import (
    Caption,
)
from tests.fakes import fake_clip, fake_sequence, write_clips, write_rows

CAPTIONS = ("a person turns left", "the left arm reaches", "walks on")


def sequence_table(
    folder: Path, n: int = 12, *, change: Callable[[Sequence], Sequence] = lambda row: row, **more
) -> SequenceTable:
    """A dataset whose rows ``change`` may alter; rows lie in all three splits, neighbours differ from the ends."""
    return write_rows(folder, [change(_with_neighbours(fake_sequence(index, **more))) for index in range(n)])


def corpus_table(folder: Path, lengths: tuple[int, ...] = (60, 90, 130), *, fps: float = 20.0) -> CorpusTable:
    """A corpus of training clips with these numbers of frames, three captions each."""
    captions = tuple(Caption(text, "atomic_action") for text in CAPTIONS)
    return write_clips(folder, [fake_clip(place, n, fps=fps, captions=captions) for place, n in enumerate(lengths)])


def _with_neighbours(row: Sequence) -> Sequence:
    """One frame fewer at either end, which becomes the neighbour."""
    joints = row.joints[1:-1]
    return replace(
        row,
        joints=joints,
        n_frames=len(joints),
        previous_joints=row.joints[0],
        next_joints=row.joints[-1],
        head_position=None,
        head_rotation=None,
        gaze_origin=row.gaze_origin[1:-1],
        gaze_direction=row.gaze_direction[1:-1],
        gaze_valid=row.gaze_valid[1:-1],
    )
