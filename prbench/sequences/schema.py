"""The tables of a built dataset: their versions, and the check of a file's columns.

The columns themselves are the fields of the records in :mod:`prbench.sequences.sequence`.

Source: docs/specification/sequence-table.md#schema-version.
"""

from __future__ import annotations

from collections.abc import Iterable

import pyarrow as pa

from prbench.errors import TableError
from prbench.geometry.skeleton import JOINT_SET
from prbench.sequences.sequence import EVENTS, RECORDINGS, SCENES, SEQUENCES

SCHEMA_VERSION = 3
"""2: ``events`` tell wrists and published priming, ``recordings`` count two more outcomes. 3: ``events`` tell what told
the hand."""
_READABLE_VERSIONS = (1, 2, 3)
SEQUENCES_VERSION = 1
"""Version of the columns of ``sequences`` alone. It enters the identity of a table, other versions do not."""
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
