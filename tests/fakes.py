"""Small made-up data for tests: smooth motions of a stick figure, and dataset folders that hold them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from prbench.randomness import named_generator
from prbench.sequences import CorpusInfo, CorpusTable, DatasetInfo, Event, Recording, Sequence, SequenceTable
from prbench.sequences.corpus import (
    ANNOTATION_OUTCOMES,
    Annotation,
    Caption,
    Clip,
    CorpusRecord,
    corpus_batch,
    write_corpus,
)
from prbench.sequences.dataset_info import CorpusCounts, FunnelCounts
from prbench.sequences.sequence import SCENES, SceneBox, event_batch, recording_batch, row_batch, sequence_batch
from prbench.sequences.write import write_dataset

STANDING = np.array(
    [
        [0.00, 0.95, 0.00],
        [0.08, 0.87, 0.00],
        [-0.08, 0.87, 0.00],
        [0.00, 1.07, 0.00],
        [0.09, 0.48, 0.01],
        [-0.09, 0.48, 0.01],
        [0.00, 1.20, 0.00],
        [0.09, 0.07, 0.00],
        [-0.09, 0.07, 0.00],
        [0.00, 1.26, 0.00],
        [0.10, 0.02, 0.13],
        [-0.10, 0.02, 0.13],
        [0.00, 1.47, -0.01],
        [0.08, 1.38, 0.00],
        [-0.08, 1.38, 0.00],
        [0.00, 1.56, 0.05],
        [0.18, 1.40, 0.00],
        [-0.18, 1.40, 0.00],
        [0.21, 1.13, 0.00],
        [-0.21, 1.13, 0.00],
        [0.22, 0.87, 0.04],
        [-0.22, 0.87, 0.04],
    ]
)
"""A standing body that faces +Z, pelvis over the origin, metres."""


def smooth_motion(name: str, n_frames: int, *, amplitude: float = 0.3) -> np.ndarray:
    """Joints (n_frames, 22, 3) float32 of the standing body swaying and drifting along smooth random curves."""
    generator = named_generator("fake", name)
    phase = np.linspace(0, 1, n_frames)[:, None]
    frequencies = generator.uniform(0.3, 1.5, size=(1, 4))
    waves = np.sin(2 * np.pi * (phase * frequencies + generator.uniform(size=(1, 4))))
    mixing = generator.normal(size=(4, 66)) * amplitude / 4
    motion = STANDING + (waves @ mixing).reshape(n_frames, 22, 3)
    motion[:, :, 1] -= motion[:, :, 1].min()
    return motion.astype(np.float32)


def fake_sequence(
    index: int, *, recordings: int = 12, n_frames: int | None = None, dataset: str = "synthetic-adt"
) -> Sequence:
    """Sequence ``index``: 2 to 6 s of smooth motion, its goal near the right wrist of the last frame."""
    generator = named_generator("fake-sequence", index)
    n = n_frames or int(generator.integers(50, 120))
    recording = index % recordings
    joints = smooth_motion(str(index), n)
    goal = joints[-1, 21] + generator.normal(size=3) * 0.04
    event_time = 50.0 + index
    start = event_time - (n - 1) / 20
    prime = start + 2.0
    name = f"{dataset}/rec{recording:03d}/obj{index}/pick/{event_time:.6f}/fake"
    split = ("train", "test", "train", "validation")[recording % 4]
    return Sequence(
        sequence_id=name,
        dataset=dataset,
        recording_id=f"rec{recording:03d}",
        participant_id=f"P{recording % 5}",
        split=split,
        split_group=f"rec{recording:03d}",
        action="pick" if index % 2 else "put",
        object_id=str(4508463855879675 + index),
        object_name="WoodenBowl",
        text="The person moves across and picks an object.",
        hand=("left", "right", None)[index % 3],
        fps=20.0,
        n_frames=n,
        start_time=start,
        prime_time=prime,
        event_time=event_time,
        prime_frame=40,
        prime_gap=event_time - prime,
        preroll=2.0,
        prime_kind="hit",
        prime_time_uncertainty=1 / 30,
        goal_location=goal.astype(np.float64),
        goal_box_world_min=goal - 0.05,
        goal_box_world_max=goal + 0.05,
        body_movement=1.0,
        hand_movement=0.5,
        pose_source="fake",
        head_tilt_deg=7.4,
        joints=joints,
        previous_joints=joints[0],
        previous_source="copied",
        next_joints=joints[-1],
        next_source="copied",
        head_position=None if index % 4 == 0 else joints[:, 15],
        head_rotation=None if index % 4 == 0 else np.tile([1.0, 0, 0, 0], (n, 1)),
        gaze_origin=joints[:, 15],
        gaze_direction=np.tile([0.0, 0, 1.0], (n, 1)),
        gaze_valid=np.ones(n, dtype=bool),
        world_from_canonical=np.eye(4),
        extra={"note": "made up"} if index % 2 else {},
    )


def fake_info(dataset: str = "synthetic-adt", sequences: int = 1) -> DatasetInfo:
    """Provenance of a made-up dataset of so many sequences."""
    counts = FunnelCounts(
        recordings_found=1, recordings_read=1, recordings_failed=0, recordings_skipped=0, events=1,
        located=1, primed=1, long_enough=1, moved_enough=1, sequences=sequences,
    )  # fmt: skip
    return DatasetInfo(
        schema_version=1, protocol_version=1, protocol_digest="p", dataset=dataset, title="Made up", synthetic=True,
        prbench_version="0", manifest_digest="m", input_digest="i", options={}, counts=counts, outcomes={},
        quarantine=(), identity_digest="", content_digest="", licence="none", redistribution="yes", homepage="",
        citation="",
    )  # fmt: skip


def fake_box(
    recording: str, *, centre=(0.0, 0.45, 0.0), half=(2.0, 0.45, 2.0), entered: float | None = 0.0
) -> SceneBox:
    """A box in one of the made-up recordings; by default all legs stand in it."""
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    place = (np.array(centre, dtype=float), upright, np.array(half, dtype=float))
    return SceneBox(recording, "77", "Counter_1", "counter", *place, entered)


def fake_event(row: Sequence, **changes) -> Event:
    """The event that became a sequence."""
    event = Event(
        event_id=row.sequence_id.rsplit("/", 1)[0], recording_id=row.recording_id, sequence_id=row.sequence_id,
        object_id=row.object_id, object_name=row.object_name, action=row.action, hand=row.hand,
        event_time=row.event_time, prime_time=row.prime_time, prime_kind=row.prime_kind,
        location=row.goal_location, box_min=row.goal_box_world_min, box_max=row.goal_box_world_max,
        outcome="sequence", stage="filters", value=1.0, threshold=0.2,
    )  # fmt: skip
    return replace(event, **changes)


def write_rows(folder: Path, rows: Iterable[Sequence]) -> SequenceTable:
    """Write a dataset of some sequences, without events and recordings, and open it."""
    rows = sorted(rows, key=lambda row: row.sequence_id)
    tables = {"events": [event_batch([])], "recordings": [recording_batch([])]}
    write_dataset(folder, fake_info(rows[0].dataset, len(rows)), sequences=[sequence_batch(rows)], **tables)
    return SequenceTable.open(folder)


def fake_clip(index: int, n_frames: int = 60, *, fps: float = 20.0, **changes) -> Clip:
    """Clip ``index`` of a made-up corpus: smooth motion with one caption."""
    motion = smooth_motion(f"clip{index}", n_frames + 2)
    clip = Clip(
        sequence_id=f"made-up/rec/{index}", dataset="made-up", recording_id="rec", participant_id="P0", split="train",
        split_group="rec", kind="atomic_action", captions=(Caption("walks on", "atomic_action"),), fps=fps,
        n_frames=n_frames, start_time=0.0, end_time=n_frames / fps, text_start=0.0, text_end=n_frames / fps,
        cut=False, mirrored=False, clock_method="same", clock_offset=0.0, clock_quality=None, approximate=False,
        pose_source="fake", head_tilt_deg=7.4, joints=motion[1:-1], previous_joints=motion[0],
        previous_source="recorded", next_joints=motion[-1], next_source="recorded", world_from_canonical=np.eye(4),
    )  # fmt: skip
    return replace(clip, **changes)


def write_clips(folder: Path, clips: Iterable[Clip], annotations: Iterable[Annotation] = (), **more) -> CorpusTable:
    """Write a corpus of one recording; ``more`` are fields of its row. Open it without looking at it."""
    clips = list(clips)
    counts = CorpusCounts(
        recordings_found=1, recordings_read=1, recordings_failed=0, recordings_skipped=0, annotations=len(clips),
        clips=len(clips), captions=sum(len(clip.captions) for clip in clips), approximate_clips=0, frames=0,
    )  # fmt: skip
    info = CorpusInfo(**(msgspec.structs.asdict(fake_info("made-up")) | {"counts": counts}))
    outcomes = dict.fromkeys(ANNOTATION_OUTCOMES, 0)
    record = CorpusRecord("rec", "P0", "train", "rec", 60.0, outcomes, "same", None, "read", "", **more)
    rows = {"clips": clips, "annotations": list(annotations), "recordings": [record]}
    tables = {name: [corpus_batch(name, each)] if each else [] for name, each in rows.items()}
    return CorpusTable(folder, write_corpus(folder, info, tables))


def fake_dataset(
    folder: Path,
    n: int = 48,
    *,
    dataset: str = "synthetic-adt",
    recordings: int = 12,
    boxes: Collection[SceneBox] = (),
    change: Callable[[Sequence], Sequence] = lambda row: row,
    **info: str,
) -> SequenceTable:
    """Write a made-up dataset of ``n`` sequences, changed and with boxes around them if wanted, and open it."""
    rows = sorted(
        (change(fake_sequence(index, dataset=dataset, recordings=recordings)) for index in range(n)),
        key=lambda row: row.sequence_id,
    )
    splits = {row.recording_id: row.split for row in rows}
    records = [
        Recording(
            recording_id=name, participant_id="P0", split=split, split_group=name, duration=60.0,
            outcomes={"sequence": sum(row.recording_id == name for row in rows)}, status="read", message="",
        )
        for name, split in sorted(splits.items())
    ]  # fmt: skip
    write_dataset(
        folder,
        msgspec.structs.replace(fake_info(dataset, len(rows)), **info),
        sequences=[sequence_batch(rows)] if rows else [],
        events=[event_batch(fake_event(row) for row in rows)],
        recordings=[recording_batch(records)],
        scenes=[row_batch(boxes, SCENES)],
    )
    return SequenceTable.open(folder)
