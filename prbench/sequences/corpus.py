"""Clips, annotations and recordings of a text-motion corpus: their columns, and their rows as Arrow batches.

Columns that the sequence table has too keep its name, type, unit and frame, so code that reads motions reads both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Self

import pyarrow as pa

from prbench.errors import TableError
from prbench.files.storage import atomic_folder, require_replaceable
from prbench.sequences.dataset_info import CORPUS_FILE, CorpusInfo
from prbench.sequences.schema import SEQUENCES, check_columns
from prbench.sequences.sequence import FrameSource, Pose, Poses, Texts, Transform, row_batch, schema_of
from prbench.sequences.table import BuiltTable
from prbench.sequences.write import require_no_loss, write_tables

CORPUS_SCHEMA_VERSION = 1
_VERSION_KEY = "prbench_corpus_schema_version"
# Possible outcomes of one annotated span of text.
ANNOTATION_OUTCOMES = (
    "clip", "no_text", "duplicate", "end_before_start", "too_short", "outside_motion", "clock_gap", "no_clock",
    "no_heading",
)  # fmt: skip


@dataclass(frozen=True)
class Caption:
    """One text of a clip.

    Attributes:
        kind: Kind of description, for example ``atomic_action`` or ``body posture``.
        tokens: ``word/POS`` tokens where the source gives them.
    """

    text: str
    kind: str
    tokens: str = ""


_CAPTION = pa.struct(list(schema_of(Caption)))


@dataclass(frozen=True)
class Clip:
    """One row of ``clips``. Canonical frame of the clip; metres, seconds.

    Attributes:
        captions: The texts of the clip, at least one.
        start_time: Time of the first frame, on the motion's clock.
        end_time: ``start_time`` plus ``n_frames`` frame times.
        text_start: Beginning of the described span on the text's own clock.
        cut: True if the described span goes on after the last frame.
        clock_offset: Motion clock minus text clock, seconds.
    """

    sequence_id: str
    dataset: str
    recording_id: str
    participant_id: str
    split: str
    split_group: str
    kind: str
    captions: Annotated[tuple[Caption, ...], pa.list_(_CAPTION), "none"]
    fps: float
    n_frames: int
    start_time: float
    end_time: float
    text_start: float
    text_end: float
    cut: bool
    mirrored: bool
    clock_method: str
    clock_offset: float
    clock_quality: float | None
    approximate: bool
    pose_source: str
    head_tilt_deg: float
    joints: Poses
    previous_joints: Pose
    previous_source: FrameSource
    next_joints: Pose
    next_source: FrameSource
    world_from_canonical: Transform
    extra: Texts = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The first caption."""
        return self.captions[0].text


@dataclass(frozen=True)
class Annotation:
    """One row of ``annotations``: one text of the source and what became of it.

    Attributes:
        value: The deciding number.
        threshold: Threshold that the value was compared with.
    """

    annotation_id: str
    recording_id: str
    sequence_id: str | None
    kind: str
    text: str
    text_start: float
    text_end: float
    outcome: str
    value: float | None = None
    threshold: float | None = None

    def __post_init__(self) -> None:
        assert self.outcome in ANNOTATION_OUTCOMES, self.outcome


@dataclass(frozen=True)
class CorpusRecord:
    """One row of ``recordings``.

    Attributes:
        recording_id: Name of the recording.
        participant_id: Name of the person.
        split: ``train``, ``validation`` or ``test``.
        split_group: Recordings of one group share the split.
        duration: Length, seconds.
        outcomes: Number of annotations by outcome.
        clock_method: The way from the text's clock to the motion's.
        clock_quality: How well the clocks agree, as the dataset has it; null where it does not tell.
        status: ``read``, ``failed`` or ``skipped``.
        message: Why it was not read, or what was noticed when it was.
        measured: Measurements of the recording, as text.
    """

    recording_id: str
    participant_id: str
    split: str
    split_group: str
    duration: float
    outcomes: Mapping[str, int]
    clock_method: str
    clock_quality: float | None
    status: str
    message: str
    measured: Texts = field(default_factory=dict)


_METADATA = {_VERSION_KEY: str(CORPUS_SCHEMA_VERSION)}
ANNOTATIONS = schema_of(Annotation).with_metadata(_METADATA)
# The first caption has a column of its own, as the text of a sequence has.
CLIPS = schema_of(Clip).insert(7, SEQUENCES.field("text").remove_metadata()).with_metadata(_METADATA)
CORPUS_RECORDINGS = schema_of(CorpusRecord, counted=ANNOTATION_OUTCOMES).with_metadata(_METADATA)
# The tables of a corpus folder by the names of their files.
CORPUS_TABLES = {"clips": CLIPS, "annotations": ANNOTATIONS, "recordings": CORPUS_RECORDINGS}


def check_corpus_schema(schema: pa.Schema, expected: pa.Schema, *, source: str) -> None:
    """Refuse a file of an unknown version or with missing or differently typed columns; further columns are welcome.

    Raises:
        TableError: naming the file, what was expected and what was found.
    """
    version = (schema.metadata or {}).get(_VERSION_KEY.encode(), b"").decode() or "none"
    if version != str(CORPUS_SCHEMA_VERSION):
        found = f"{version}. Build the corpus again with `prbench build-corpus`, or update prbench."
        raise TableError(f"{source}: expected version {CORPUS_SCHEMA_VERSION} of the corpus schema, found {found}")
    check_columns(schema, expected, source=source, what="corpus")


def corpus_batch(table: str, rows: Iterable[Clip | Annotation | CorpusRecord]) -> pa.RecordBatch:
    """Return Arrow rows of a corpus table (``clips``, ``annotations`` or ``recordings``), in the order given."""
    return row_batch(rows, CORPUS_TABLES[table], counted=ANNOTATION_OUTCOMES if table == "recordings" else ())


class CorpusTable(BuiltTable[CorpusInfo]):
    """A built corpus: its folder, its provenance, and its clips on demand."""

    description = CorpusInfo
    main = "clips"
    schemas = CORPUS_TABLES
    identity_columns = ("sequence_id", "split", "kind", "n_frames")
    check = staticmethod(check_corpus_schema)

    @classmethod
    def open(cls, folder: Path | str) -> Self:
        """Open a corpus folder as any table is opened, and check that it holds clips.

        Raises:
            TableError: naming the file, what was expected and what was found.
        """
        table = super().open(folder)
        if table.n_rows == 0:
            why = f"the corpus has no clips. `{table.folder / CORPUS_FILE}` holds the counts that say why;"
            reason = "the table 'annotations' tells it of every text."
            raise TableError(f"{folder}: {why} {reason}")
        return table

    def _is_short(self, field: pa.Field) -> bool:
        return super()._is_short(field) or field.name == "captions"

    def annotations(self) -> pa.Table:
        """Return the ``annotations`` table: every text of the source and what became of it."""
        return self._read("annotations")

    def recordings(self) -> pa.Table:
        """Return the ``recordings`` table."""
        return self._read("recordings")


def write_corpus(
    folder: Path, info: CorpusInfo, tables: Mapping[str, Iterable[pa.RecordBatch]], *, replace: bool = False
) -> CorpusInfo:
    """Write a corpus folder whole or not at all; a corpus that was there is replaced, anything else is not touched.

    Args:
        folder: The corpus folder.
        info: Provenance; its digests are filled in here.
        tables: Rows of ``clips`` (sorted by ``sequence_id`` within each recording), ``annotations``, ``recordings``.
        replace: Replace a corpus that holds recordings which this one lacks.

    Returns:
        The provenance as written.

    Raises:
        StorageError: if the folder holds something that is no corpus, or cannot be written.
        RecordingsWouldBeLost: if the corpus that was there holds more, and ``replace`` is not set.
    """
    require_replaceable(folder, CORPUS_FILE, kind="corpus")
    recordings = list(tables["recordings"])
    if not replace:
        require_no_loss(folder, CORPUS_FILE, recordings, outcome="clip", what="clips")
    with atomic_folder(folder) as temporary:
        info = write_tables(
            temporary, info, {**tables, "recordings": recordings}, CORPUS_TABLES, CorpusTable.identity_columns
        )
    return info
