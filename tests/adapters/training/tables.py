"""Small made-up tables for the tests of training data: sequences, and a corpus with several captions a clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from prbench.sequences import CorpusInfo, CorpusTable, Sequence, SequenceTable
from prbench.sequences.corpus import (
    ANNOTATION_OUTCOMES,
    Caption,
    Clip,
    CorpusRecord,
    corpus_batch,
    write_corpus,
)
from prbench.sequences.dataset_info import CorpusCounts
from prbench.sequences.sequence import event_batch, recording_batch, sequence_batch
from prbench.sequences.write import write_dataset
from tests.fakes import fake_info, fake_sequence, smooth_motion

CAPTIONS = ("a person turns left", "the left arm reaches", "walks on")


def sequence_table(
    folder: Path, n: int = 12, *, change: Callable[[Sequence], Sequence] = lambda row: row, **more
) -> SequenceTable:
    """A dataset whose rows ``change`` may alter; rows lie in all three splits, neighbours differ from the ends."""
    rows = [change(_with_neighbours(fake_sequence(index, **more))) for index in range(n)]
    rows.sort(key=lambda row: row.sequence_id)
    write_dataset(
        folder,
        fake_info(rows[0].dataset),
        sequences=[sequence_batch(rows)],
        events=[event_batch([])],
        recordings=[recording_batch([])],
    )
    return SequenceTable.open(folder)


def corpus_table(folder: Path, lengths: tuple[int, ...] = (60, 90, 130), *, fps: float = 20.0) -> CorpusTable:
    """A corpus of training clips with these numbers of frames, three captions each."""
    clips = [_clip(index, n_frames, fps) for index, n_frames in enumerate(lengths)]
    record = CorpusRecord(
        recording_id="rec", participant_id="P0", split="train", split_group="rec", duration=60.0,
        outcomes=dict.fromkeys(ANNOTATION_OUTCOMES, 0), clock_method="same", clock_quality=None, status="read",
        message="",
    )  # fmt: skip
    tables = {
        "clips": [corpus_batch("clips", clips)],
        "annotations": [],
        "recordings": [corpus_batch("recordings", [record])],
    }
    return CorpusTable(folder, write_corpus(folder, _corpus_info(len(clips)), tables))


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


def _clip(index: int, n_frames: int, fps: float) -> Clip:
    motion = smooth_motion(f"clip{index}", n_frames + 2)
    return Clip(
        sequence_id=f"made-up/rec/{index}", dataset="made-up", recording_id="rec", participant_id="P0", split="train",
        split_group="rec", kind="atomic_action", captions=tuple(Caption(text, "atomic_action") for text in CAPTIONS),
        fps=fps, n_frames=n_frames, start_time=0.0, end_time=n_frames / fps, text_start=0.0, text_end=n_frames / fps,
        cut=False, mirrored=False, clock_method="same", clock_offset=0.0, clock_quality=None, approximate=False,
        pose_source="fake", head_tilt_deg=7.4, joints=motion[1:-1], previous_joints=motion[0],
        previous_source="recorded", next_joints=motion[-1], next_source="recorded",
        world_from_canonical=np.eye(4),
    )  # fmt: skip


def _corpus_info(n: int) -> CorpusInfo:
    counts = CorpusCounts(
        recordings_found=1, recordings_read=1, recordings_failed=0, recordings_skipped=0, annotations=n, clips=n,
        captions=3 * n, approximate_clips=0, frames=0,
    )  # fmt: skip
    shared = msgspec.structs.asdict(fake_info("made-up")) | {"counts": counts}
    return CorpusInfo(**shared)
