"""One clip, one annotation, one recording of a text-motion corpus, and their Arrow rows."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from jaxtyping import Float

from prbench.sequences.arrow import column
from prbench.sequences.corpus_schema import ANNOTATION_OUTCOMES, ANNOTATIONS, CLIPS, CORPUS_RECORDINGS
from prbench.sequences.sequence import FrameSource


@dataclass(frozen=True)
class Caption:
    """One text of a clip."""

    text: str
    kind: str
    """What the text describes, for example ``atomic_action`` or ``body posture``."""
    tokens: str = ""
    """``word/POS`` tokens where the source gives them."""


@dataclass(frozen=True)
class Clip:
    """One row of ``clips``. Canonical frame of the clip; metres, seconds."""

    sequence_id: str
    dataset: str
    recording_id: str
    participant_id: str
    split: str
    split_group: str
    kind: str
    captions: tuple[Caption, ...]
    """At least one."""
    fps: float
    n_frames: int
    start_time: float
    """Of the first frame, on the motion's clock."""
    end_time: float
    """``start_time`` plus ``n_frames`` frame times."""
    text_start: float
    """Beginning of the described span on the text's own clock."""
    text_end: float
    cut: bool
    """Whether the described span goes on after the last frame."""
    mirrored: bool
    clock_method: str
    clock_offset: float
    """Motion clock minus text clock, seconds."""
    clock_quality: float | None
    approximate: bool
    pose_source: str
    head_tilt_deg: float
    joints: Float[np.ndarray, "n 22 3"]
    previous_joints: Float[np.ndarray, "22 3"]
    previous_source: FrameSource
    next_joints: Float[np.ndarray, "22 3"]
    next_source: FrameSource
    world_from_canonical: Float[np.ndarray, "4 4"]
    extra: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The first caption."""
        return self.captions[0].text


@dataclass(frozen=True)
class Annotation:
    """One row of ``annotations``: one text of the source and what became of it."""

    annotation_id: str
    recording_id: str
    sequence_id: str | None
    kind: str
    text: str
    text_start: float
    text_end: float
    outcome: str
    value: float | None = None
    """The deciding number."""
    threshold: float | None = None
    """What it was compared with."""

    def __post_init__(self) -> None:
        assert self.outcome in ANNOTATION_OUTCOMES, self.outcome


@dataclass(frozen=True)
class CorpusRecord:
    """One row of ``recordings``."""

    recording_id: str
    participant_id: str
    split: str
    split_group: str
    duration: float
    outcomes: Mapping[str, int]
    """Number of annotations by outcome."""
    clock_method: str
    clock_quality: float | None
    status: str
    """``read``, ``failed`` or ``skipped``."""
    message: str
    measured: Mapping[str, str] = field(default_factory=dict)
    """What was measured about the recording, as text."""


def clip_batch(clips: Iterable[Clip]) -> pa.RecordBatch:
    """Arrow rows of clips, in the order given."""
    rows = list(clips)
    columns = [
        _captions(rows) if name == "captions" else column([getattr(row, name) for row in rows], CLIPS.field(name).type)
        for name in CLIPS.names
    ]
    return pa.RecordBatch.from_arrays(columns, schema=CLIPS)


def annotation_batch(annotations: Iterable[Annotation]) -> pa.RecordBatch:
    """Arrow rows of annotations, in the order given."""
    return pa.RecordBatch.from_pylist([dataclasses.asdict(row) for row in annotations], schema=ANNOTATIONS)


def corpus_recording_batch(records: Iterable[CorpusRecord]) -> pa.RecordBatch:
    """Arrow rows of recordings, in the order given."""
    rows = []
    for record in records:
        row = dataclasses.asdict(record)
        counts, measured = row.pop("outcomes"), row.pop("measured")
        row |= {outcome: counts.get(outcome, 0) for outcome in ANNOTATION_OUTCOMES}
        rows.append(row | {"measured": [{"key": key, "value": text} for key, text in sorted(measured.items())]})
    return pa.RecordBatch.from_pylist(rows, schema=CORPUS_RECORDINGS)


def _captions(rows: list[Clip]) -> pa.Array:
    values = [[dataclasses.asdict(caption) for caption in row.captions] for row in rows]
    return pa.array(values, type=CLIPS.field("captions").type)
