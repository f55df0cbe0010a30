"""The columns of a built dataset: sequences, events and recordings.

Source: docs/specification/sequence-table.md#schema-version.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from prbench.errors import TableError
from prbench.geometry.skeleton import JOINT_SET, N_JOINTS

SCHEMA_VERSION = 3
"""2: ``events`` tell wrists and published priming, ``recordings`` count two more outcomes. 3: ``events`` tell what told
the hand."""
_READABLE_VERSIONS = (1, 2, 3)
SEQUENCES_VERSION = 1
"""Version of the columns of ``sequences`` alone. It enters the identity of a table, other versions do not."""
OUTCOMES = (
    "sequence",
    "no_location",
    "not_primed",
    "too_short",
    "minimum_movement",
    "no_body",
    "other_wearer",
    "excluded_category",
    "tracking_lost",
    "excluded_by_dataset",
    "not_published",
)
"""Possible outcomes of a candidate event."""
_POSE = pa.list_(pa.float32(), N_JOINTS * 3)
_POINT = pa.list_(pa.float32(), 3)
_PRECISE_POINT = pa.list_(pa.float64(), 3)
KEY_VALUES = pa.list_(pa.struct([pa.field("key", pa.string()), pa.field("value", pa.string())]))
"""A map, written as a list of pairs: readers that know no maps (Hugging Face ``datasets``) open it too."""
_SINCE_VERSION = {
    "left_wrist": 2,
    "right_wrist": 2,
    "published_priming": 2,
    "published_prime_time": 2,
    "excluded_by_dataset": 2,
    "not_published": 2,
    "hand_source": 3,
}
"""Version of the tables in which a column was added; the others are there from the beginning."""
UNITS = {
    "length": "m",
    "time": "s",
    "angle": "deg where a name says so",
    "quaternion": "w x y z",
    "world": "Y up, right-handed",
    "canonical": "pelvis of frame 0 over the origin facing +Z, lowest joint of the sequence at Y = 0",
}


def column_field(name: str, kind: pa.DataType, *, nullable: bool = False) -> pa.Field:
    """Return a column of a table; unlike Arrow's own default, it holds no nulls unless it says so."""
    return pa.field(name, kind, nullable=nullable)


SEQUENCES = pa.schema(
    [
        column_field("sequence_id", pa.string()),
        column_field("dataset", pa.string()),
        column_field("recording_id", pa.string()),
        column_field("participant_id", pa.string()),
        column_field("split", pa.string()),
        column_field("split_group", pa.string()),
        column_field("action", pa.string()),
        column_field("object_id", pa.string()),
        column_field("object_name", pa.string()),
        column_field("text", pa.string()),
        column_field("hand", pa.string(), nullable=True),
        column_field("fps", pa.float64()),
        column_field("n_frames", pa.int32()),
        column_field("start_time", pa.float64()),
        column_field("prime_time", pa.float64()),
        column_field("event_time", pa.float64()),
        column_field("prime_frame", pa.int32()),
        column_field("prime_gap", pa.float64()),
        column_field("preroll", pa.float64()),
        column_field("prime_kind", pa.string()),
        column_field("prime_time_uncertainty", pa.float64()),
        column_field("goal_location", _PRECISE_POINT),
        column_field("goal_box_world_min", _PRECISE_POINT),
        column_field("goal_box_world_max", _PRECISE_POINT),
        column_field("body_movement", pa.float64()),
        column_field("hand_movement", pa.float64()),
        column_field("pose_source", pa.string()),
        column_field("head_tilt_deg", pa.float64()),
        column_field("joints", pa.list_(_POSE)),
        column_field("previous_joints", _POSE),
        column_field("previous_source", pa.string()),
        column_field("next_joints", _POSE),
        column_field("next_source", pa.string()),
        column_field("head_position", pa.list_(_POINT), nullable=True),
        column_field("head_rotation", pa.list_(pa.list_(pa.float32(), 4)), nullable=True),
        column_field("gaze_origin", pa.list_(_POINT)),
        column_field("gaze_direction", pa.list_(_POINT)),
        column_field("gaze_valid", pa.list_(pa.bool_())),
        column_field("world_from_canonical", pa.list_(pa.float64(), 16)),
        column_field("extra", KEY_VALUES),
    ]
)
EVENTS = pa.schema(
    [
        column_field("event_id", pa.string()),
        column_field("recording_id", pa.string()),
        column_field("sequence_id", pa.string(), nullable=True),
        column_field("object_id", pa.string()),
        column_field("object_name", pa.string()),
        column_field("action", pa.string()),
        column_field("hand", pa.string(), nullable=True),
        column_field("event_time", pa.float64()),
        column_field("prime_time", pa.float64(), nullable=True),
        column_field("prime_kind", pa.string(), nullable=True),
        column_field("location", _PRECISE_POINT, nullable=True),
        column_field("box_min", _PRECISE_POINT, nullable=True),
        column_field("box_max", _PRECISE_POINT, nullable=True),
        column_field("outcome", pa.string()),
        column_field("stage", pa.string()),
        column_field("value", pa.float64(), nullable=True),
        column_field("threshold", pa.float64(), nullable=True),
        column_field("left_wrist", _PRECISE_POINT, nullable=True),
        column_field("right_wrist", _PRECISE_POINT, nullable=True),
        column_field("published_priming", pa.string(), nullable=True),
        column_field("published_prime_time", pa.float64(), nullable=True),
        column_field("hand_source", pa.string(), nullable=True),
    ]
)
RECORDINGS = pa.schema(
    [
        column_field("recording_id", pa.string()),
        column_field("participant_id", pa.string()),
        column_field("split", pa.string()),
        column_field("split_group", pa.string()),
        column_field("duration", pa.float64()),
        *(column_field(outcome, pa.int32()) for outcome in OUTCOMES),
        column_field("status", pa.string()),
        column_field("message", pa.string()),
    ]
)
SCENES = pa.schema(
    [
        column_field("recording_id", pa.string()),
        column_field("object_id", pa.string()),
        column_field("name", pa.string()),
        column_field("category", pa.string()),
        column_field("centre", _PRECISE_POINT),
        column_field("rotation", pa.list_(pa.float64(), 4)),
        column_field("half_extents", _PRECISE_POINT),
        column_field("entered", pa.float64(), nullable=True),
    ]
)
DATASET_TABLES = {"sequences": SEQUENCES, "events": EVENTS, "recordings": RECORDINGS}
"""The tables of a dataset folder by the names of their files."""
OPTIONAL_TABLES = {"scenes": SCENES}
"""Tables that a dataset folder has only where its recordings know what they hold (docs/specification/scene.md)."""


def with_metadata(schema: pa.Schema, *, protocol_version: int) -> pa.Schema:
    """The schema with version, joint set and units as Parquet metadata, beside what it carries already."""
    carried = {key.decode(): value for key, value in (schema.metadata or {}).items()}
    return schema.with_metadata(
        {
            **carried,
            "prbench_schema_version": str(SCHEMA_VERSION),
            "prbench_protocol_version": str(protocol_version),
            "joint_set": carried.get("joint_set", JOINT_SET),
            **{f"unit_{quantity}": unit for quantity, unit in UNITS.items()},
        }
    )


def check_schema(schema: pa.Schema, expected: pa.Schema, *, source: str) -> None:
    """Refuse a file of an unknown version or with missing or differently typed columns; further columns are welcome.

    Raises:
        TableError: naming the file, what was expected and what was found.
    """
    metadata = schema.metadata or {}
    version = metadata.get(b"prbench_schema_version", b"").decode() or "none"
    if version not in {str(known) for known in _READABLE_VERSIONS}:
        known = ", ".join(map(str, _READABLE_VERSIONS))
        raise TableError(
            f"{source}: expected schema version {known}, found {version}."
            " Build the dataset again with `prbench build-dataset`, or update prbench."
        )
    # An older table lacks columns that came later; they are filled in when it is read.
    later = {name for name, since in _SINCE_VERSION.items() if since > int(version)}
    known = [field for field in expected if field.name not in later or schema.get_field_index(field.name) >= 0]
    check_columns(schema, known, source=source, what="dataset")


def check_columns(schema: pa.Schema, expected: Iterable[pa.Field], *, source: str, what: str) -> None:
    """Refuse a file with other joints, or with missing or differently typed columns.

    Args:
        schema: The columns of the file.
        expected: Columns that it must have.
        source: The file, for the message.
        what: Thing to build again: ``dataset`` or ``corpus``.

    Raises:
        TableError: naming the file, what was expected and what was found.
    """
    joint_set = (schema.metadata or {}).get(b"joint_set", b"").decode()
    if joint_set != JOINT_SET:
        raise TableError(f"{source}: expected joint set {JOINT_SET}, found {joint_set or 'none'}.")
    for field in expected:
        index = schema.get_field_index(field.name)  # also below 0 where the name stands twice
        if index < 0:
            raise TableError(f"{source}: expected a column '{field.name}', found none. Build the {what} again.")
        found = schema.field(index).type
        if not found.equals(field.type):
            raise TableError(f"{source}: column '{field.name}': expected {field.type}, found {found}.")


def with_later_columns(table: pa.Table, expected: pa.Schema) -> pa.Table:
    """A table of an older version with the columns that came later: null, or 0 where a column counts something."""
    for field in expected:
        if table.schema.get_field_index(field.name) >= 0:
            continue
        values = pa.nulls(len(table), field.type) if field.nullable else pa.repeat(pa.scalar(0, field.type), len(table))
        table = table.append_column(field, values)
    return table
