"""The columns of a text-motion corpus: clips, annotations and recordings.

Columns that the sequence table has too keep its name, type, unit and frame: code that reads motions reads both.
"""

from __future__ import annotations

import pyarrow as pa

from prbench.errors import TableError
from prbench.sequences.schema import KEY_VALUES, SEQUENCES
from prbench.skeleton import JOINT_SET

CORPUS_SCHEMA_VERSION = 1
_VERSION_KEY = "prbench_corpus_schema_version"

ANNOTATION_OUTCOMES = (
    "clip",
    "no_text",
    "duplicate",
    "end_before_start",
    "too_short",
    "outside_motion",
    "clock_gap",
    "no_clock",
    "no_heading",
)
"""What can become of one annotated span of text."""

CAPTION = pa.struct(
    [
        pa.field("text", pa.string(), nullable=False),
        pa.field("kind", pa.string(), nullable=False),
        pa.field("tokens", pa.string(), nullable=False),
    ]
)
"""One text of a clip; ``tokens`` as the source gives them (``word/POS``), else empty."""


def _shared(*names: str) -> list[pa.Field]:
    return [SEQUENCES.field(name) for name in names]


def _field(name: str, kind: pa.DataType, *, nullable: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable=nullable)


_METADATA = {_VERSION_KEY: str(CORPUS_SCHEMA_VERSION)}

CLIPS = pa.schema(
    [
        *_shared("sequence_id", "dataset", "recording_id", "participant_id", "split", "split_group"),
        _field("kind", pa.string()),
        *_shared("text"),
        _field("captions", pa.list_(CAPTION)),
        *_shared("fps", "n_frames", "start_time"),
        _field("end_time", pa.float64()),
        _field("text_start", pa.float64()),
        _field("text_end", pa.float64()),
        _field("cut", pa.bool_()),
        _field("mirrored", pa.bool_()),
        _field("clock_method", pa.string()),
        _field("clock_offset", pa.float64()),
        _field("clock_quality", pa.float64(), nullable=True),
        _field("approximate", pa.bool_()),
        *_shared(
            "pose_source", "head_tilt_deg", "joints", "previous_joints", "previous_source", "next_joints", "next_source"
        ),
        *_shared("world_from_canonical", "extra"),
    ],
    metadata=_METADATA,
)

ANNOTATIONS = pa.schema(
    [
        _field("annotation_id", pa.string()),
        _field("recording_id", pa.string()),
        _field("sequence_id", pa.string(), nullable=True),
        _field("kind", pa.string()),
        _field("text", pa.string()),
        _field("text_start", pa.float64()),
        _field("text_end", pa.float64()),
        _field("outcome", pa.string()),
        _field("value", pa.float64(), nullable=True),
        _field("threshold", pa.float64(), nullable=True),
    ],
    metadata=_METADATA,
)

CORPUS_RECORDINGS = pa.schema(
    [
        *_shared("recording_id", "participant_id", "split", "split_group"),
        _field("duration", pa.float64()),
        *(_field(outcome, pa.int32()) for outcome in ANNOTATION_OUTCOMES),
        _field("clock_method", pa.string()),
        _field("clock_quality", pa.float64(), nullable=True),
        _field("status", pa.string()),
        _field("message", pa.string()),
        _field("measured", KEY_VALUES),
    ],
    metadata=_METADATA,
)

CORPUS_TABLES = {"clips": CLIPS, "annotations": ANNOTATIONS, "recordings": CORPUS_RECORDINGS}
"""The tables of a corpus folder by the names of their files."""


def check_corpus_schema(schema: pa.Schema, expected: pa.Schema, *, source: str) -> None:
    """Refuse a file of an unknown version or with missing or differently typed columns; further columns are welcome.

    Raises:
        TableError: naming the file, what was expected and what was found.
    """
    metadata = schema.metadata or {}
    version = metadata.get(_VERSION_KEY.encode(), b"").decode() or "none"
    if version != str(CORPUS_SCHEMA_VERSION):
        raise TableError(
            f"{source}: expected version {CORPUS_SCHEMA_VERSION} of the corpus schema, found {version}."
            " Build the corpus again with `prbench build-corpus`, or update prbench."
        )
    joint_set = metadata.get(b"joint_set", b"").decode()
    if joint_set != JOINT_SET:
        raise TableError(f"{source}: expected joint set {JOINT_SET}, found {joint_set or 'none'}.")
    for field in expected:
        index = schema.get_field_index(field.name)
        if index < 0:
            raise TableError(f"{source}: expected a column '{field.name}', found none. Build the corpus again.")
        found = schema.field(index).type
        if not found.equals(field.type):
            raise TableError(f"{source}: column '{field.name}': expected {field.type}, found {found}.")
