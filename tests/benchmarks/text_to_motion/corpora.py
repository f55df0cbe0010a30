"""A small made-up corpus whose captions can be told apart, and evaluators for it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np

from prbench.sequences import CorpusInfo, CorpusTable
from prbench.sequences.corpus import ANNOTATION_OUTCOMES, Caption, Clip, CorpusRecord, corpus_batch, write_corpus
from prbench.sequences.dataset_info import CorpusCounts
from tests.fakes import fake_info, smooth_motion

WORDS = ("walks", "sits", "turns", "reaches", "picks", "puts", "looks", "waits")
TINY = {
    "movement_width": 8,
    "motion_width": 8,
    "text_width": 8,
    "embedding": 8,
    "text": "hashed-ngrams",
    "max_frames": 60,
}
"""Keys of ``[model]``."""


def made_up_corpus(folder: Path, n: int = 44) -> CorpusTable:
    """``n`` clips of each split, of 24 to 43 frames; two captions each, of different kinds, no two clips alike."""
    clips = [_clip(split, index) for split in ("test", "train", "validation") for index in range(n)]
    records = [
        CorpusRecord(
            recording_id=split, participant_id="P0", split=split, split_group=split, duration=60.0,
            outcomes=dict.fromkeys(ANNOTATION_OUTCOMES, 0), clock_method="same", clock_quality=None, status="read",
            message="",
        )
        for split in ("test", "train", "validation")
    ]  # fmt: skip
    counts = CorpusCounts(
        recordings_found=3, recordings_read=3, recordings_failed=0, recordings_skipped=0, annotations=len(clips),
        clips=len(clips), captions=2 * len(clips), approximate_clips=0, frames=0,
    )  # fmt: skip
    info = CorpusInfo(**(msgspec.structs.asdict(fake_info("made-up")) | {"counts": counts}))
    tables = {
        "clips": [corpus_batch("clips", clips)],
        "annotations": [],
        "recordings": [corpus_batch("recordings", records)],
    }
    return CorpusTable(folder, write_corpus(folder, info, tables))


def _clip(split: str, index: int) -> Clip:
    n_frames = 24 + index % 20
    motion = smooth_motion(f"{split}{index}", n_frames + 2)
    first, second = WORDS[index % 8], WORDS[index // 8 % 8]
    captions = (Caption(f"C {first} and {second}.", "atomic_action"), Caption(f"{second} {index}", "summary"))
    return Clip(
        sequence_id=f"made-up/{split}/{index:03d}", dataset="made-up", recording_id=split, participant_id="P0",
        split=split, split_group=split, kind="atomic_action", captions=captions, fps=20.0, n_frames=n_frames,
        start_time=0.0, end_time=n_frames / 20, text_start=0.0, text_end=n_frames / 20, cut=False, mirrored=False,
        clock_method="same", clock_offset=0.0, clock_quality=None, approximate=False, pose_source="fake",
        head_tilt_deg=7.4, joints=motion[1:-1], previous_joints=motion[0], previous_source="recorded",
        next_joints=motion[-1], next_source="recorded", world_from_canonical=np.eye(4),
    )  # fmt: skip
