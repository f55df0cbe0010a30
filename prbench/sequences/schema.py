"""The tables of a built dataset: versions, the check of a file's columns, rows in Parquet files, and digests.

The columns themselves are the fields of the records in :mod:`prbench.sequences.sequence`.
Source: docs/specification/sequence-table.md#schema-version.

The identity digest says which sequences a table holds, the content digest says which values. ``dataset.json`` and
``corpus.json`` also hold the SHA-256 of every Parquet file beside them. Whenever a table is opened, the values of its
main table are compared with the content digest, and the bytes of the others with theirs: a digest of bytes is remade
together with an edit, and nothing is remembered that an edit could get past. Written anew with equal values, a main
table is still the same. It takes 2 s for 10,000 sequences.
"""

from __future__ import annotations

import contextlib
import hashlib
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from prbench.errors import TableError
from prbench.files import arrays, bounded, storage
from prbench.files.arrays import first_repeated
from prbench.geometry.skeleton import JOINT_SET
from prbench.limits import LATEST_TIME
from prbench.sequences.sequence import EVENTS, RECORDINGS, SCENES, SEQUENCES, SequenceChunk
from prbench.shown import quoted

# 2: ``events`` tell wrists and published priming, ``recordings`` count two more outcomes. 3: ``events`` tell what told
# the hand. 4: ``events`` tell confidence and corrections, ``recordings`` count three more outcomes. 5: ``events`` tell
# where they are in the video.
SCHEMA_VERSION = 5
# Columns that older versions lack. They are read too: what they do not tell is null, what they do not count is 0.
_ADDED_IN_4 = {"prime_margin", "event_confidence", "corrected", "unreadable"}
_ADDED_IN_4 |= {"unreadable_entry", "low_confidence", "annotation_only", "dropped_by_person"}
ADDED_COLUMNS = {"3": _ADDED_IN_4 | {"video"}, "4": {"video"}, "5": set()}
# Version of the columns of ``sequences`` alone. It enters the identity of a table, other versions do not.
SEQUENCES_VERSION = 1
UNITS = {
    "length": "m",
    "time": "s",
    "angle": "deg where a name says so",
    "quaternion": "w x y z",
    "world": "Y up, right-handed",
    "canonical": "pelvis of frame 0 over the origin facing +Z, lowest joint of the sequence at Y = 0",
}


# The tables of a dataset folder by the names of their files.
DATASET_TABLES = {"sequences": SEQUENCES, "events": EVENTS, "recordings": RECORDINGS}
# Tables that a dataset folder has only where its recordings know what they hold (docs/specification/scene.md).
OPTIONAL_TABLES = {"scenes": SCENES}


def with_metadata(schema: pa.Schema, *, protocol_version: int) -> pa.Schema:
    """Return the schema with version, joint set and units as Parquet metadata, beside what it carries already."""
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

    A file of an older version may lack the columns that were added later (:func:`with_added_columns`).

    Raises:
        TableError: naming the file, what was expected and what was found.
    """
    version = (schema.metadata or {}).get(b"prbench_schema_version", b"").decode() or "none"
    if version not in ADDED_COLUMNS:
        remedy = "Build the dataset again with `prbench build-dataset`, or update prbench."
        raise TableError(f"{source}: expected schema version 3 to {SCHEMA_VERSION}, found {version}. {remedy}")
    lacking = ADDED_COLUMNS[version]
    check_columns(schema, [field for field in expected if field.name not in lacking], source=source, what="dataset")


def with_added_columns(table: pa.Table, schema: pa.Schema) -> pa.Table:
    """Return a table of an older version with today's columns in their places: nulls, or 0 where a column counts."""
    for place, field in enumerate(schema):
        if field.name not in table.column_names:
            missing = None if field.nullable else 0
            table = table.add_column(place, field, pa.array([missing] * len(table), field.type))
    return table


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


ROUNDING = 1e-5  # metres, seconds and unit vectors alike: 10 micrometres


def identity_of_rows(rows: pa.Table, *, protocol_version: int) -> str:
    """Digest what two laboratories with the same licensed data share: sorted ids with split, action and length.

    Args:
        rows: The columns ``sequence_id``, ``split``, ``action`` (of a corpus ``kind``) and ``n_frames``, in this order.
        protocol_version: Version of the protocol that the table was built with.
    """
    digest = hashlib.sha256(f"prbench schema {SEQUENCES_VERSION} protocol {protocol_version}\n".encode())
    batches = rows.to_batches(max_chunksize=1024)
    in_order: Iterable[tuple] = (row for batch in batches for row in zip(*(column.to_pylist() for column in batch)))
    # Sorted: two laboratories may have built the same rows in another order. A table is sorted already, so its rows
    # need not all become Python's objects.
    ids = rows.column(0)
    rising = pc.call_function("less", [ids.slice(0, max(len(ids) - 1, 0)), ids.slice(1)])
    if not pc.call_function("all", [rising]).as_py():
        in_order = sorted(in_order)
    for row in in_order:
        digest.update("\t".join(map(str, row)).encode() + b"\n")
    return digest.hexdigest()


_AT_ONCE = 2**14  # numbers rounded together: with those of a whole batch it takes ten times as long


class ContentDigest:
    """Digest of the values, rounded to 10 µm, in the order of the rows; not of the file's bytes."""

    def __init__(self, columns: SequenceOf[str] = tuple(SEQUENCES.names)) -> None:
        # Presence, lengths and values of each column are streams of their own, so that batch borders do not show.
        self._columns = {name: [hashlib.sha256() for _ in range(3)] for name in columns}

    def update(self, batch: pa.RecordBatch) -> None:
        """Take up rows; how they are cut into batches leaves no trace."""
        for name, (presence, lengths, values) in self._columns.items():
            column = batch.column(name)
            presence.update(np.asarray(column.is_valid(), dtype=np.uint8).tobytes())
            kind = column.type
            if pa.types.is_string(kind) or (pa.types.is_list(kind) and pa.types.is_struct(kind.value_type)):
                for value in column.to_pylist():
                    values.update(repr(value).encode() + b"\n")
                continue
            if pa.types.is_list(kind):
                lengths.update(np.asarray(column.value_lengths().fill_null(0), dtype=np.int64).tobytes())
                column = column.flatten()
            if pa.types.is_fixed_size_list(column.type):
                column = column.flatten()
            values.update(_rounded(column).tobytes())

    def hexdigest(self) -> str:
        """SHA-256 over the digests of the columns."""
        total = hashlib.sha256()
        for name, streams in self._columns.items():
            total.update(name.encode() + b"".join(stream.digest() for stream in streams))
        return total.hexdigest()


def _rounded(leaf: pa.Array) -> np.ndarray:
    """Integers that stand for the values: multiples of 10 µm for floats (32 bits hold 21 km)."""
    if pa.types.is_boolean(leaf.type):
        return np.asarray(leaf.fill_null(False), dtype=np.uint8)
    numbers = np.asarray(leaf.fill_null(0) if leaf.null_count else leaf)
    if not pa.types.is_floating(leaf.type):
        return numbers.astype(np.int64)
    rounded = np.empty(numbers.shape, np.int32 if leaf.type == pa.float32() else np.int64)
    for first in range(0, len(numbers), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        # A product, not a quotient, and in float64: other processors then round to the same integers.
        rounded[part] = np.rint(numbers[part] * np.float64(1 / ROUNDING))
    return rounded


def digests_of_files(folder: Path, tables: Iterable[str]) -> dict[str, str]:
    """SHA-256 of each Parquet file of some tables, by its path relative to the folder; absent files are left out."""
    paths = [path for name in tables for path in files_of_table(folder, name)]
    return {path.relative_to(folder).as_posix(): storage.file_digest(path) for path in paths}


def require_form(batch: pa.RecordBatch, expected: pa.Schema, source: Path) -> None:
    """Refuse rows that no build writes, however their digests were made: code relies on their form.

    Args:
        batch: Rows of a main table.
        expected: Its columns.
        source: The file, for the message.

    Raises:
        TableError: for a missing value, a number that is not finite, an impossible rate or number of frames, or values
            of another number of frames.
    """
    frames = batch.column("n_frames").fill_null(0).to_numpy()
    checks = [
        ("fps", batch.column("fps").fill_null(0).to_numpy() <= 0, "a rate above 0"),
        ("n_frames", frames < 1, "1 or more"),
    ]
    for field in expected:
        column = batch.column(field.name)
        if not field.nullable:
            checks.append((field.name, column.is_null().to_numpy(zero_copy_only=False), "a value"))
        if pa.types.is_list(field.type) and not pa.types.is_struct(field.type.value_type):
            lengths = column.value_lengths().to_numpy(zero_copy_only=False)
            checks.append((field.name, ~np.isnan(lengths) & (lengths != frames), "as many values as frames"))
        elif pa.types.is_floating(field.type) or (pa.types.is_fixed_size_list(field.type) and not column.null_count):
            numbers = column.flatten() if pa.types.is_fixed_size_list(field.type) else column
            usual = np.abs(numbers.fill_null(0).to_numpy()) <= LATEST_TIME  # no other number is as large
            checks.append((field.name, ~usual.reshape(len(batch), -1).all(axis=1), f"numbers within {LATEST_TIME:g}"))
    for name, wrong, wanted in checks:
        if wrong.any():
            row = batch.column(expected.names[0])[int(wrong.argmax())].as_py()
            remedy = "Build the table again."
            raise TableError(f"{source}, {quoted(row)}, column '{name}': expected {wanted}, found another. {remedy}")


def files_of_table(folder: Path, table: str) -> list[Path]:
    """Return the Parquet file of a table, or the parts of a folder in order; none where it is absent."""
    single = folder / f"{table}.parquet"
    return [single] if single.is_file() else sorted((folder / table).glob("part-*.parquet"))


def table_of(path: str) -> str:
    """Return the name of the table that a file, named relative to its folder, belongs to."""
    return path.split("/")[0].removesuffix(".parquet")


def table_parts(folder: Path, name: str) -> list[Path]:
    """Return the Parquet files of one table: a single file, or the parts of a folder in order.

    Raises:
        TableError: if neither exists.
    """
    found = files_of_table(folder, name)
    if not found:
        raise TableError(f"{folder}: expected {name}.parquet or {name}/part-*.parquet, found neither.")
    return found


def stream_chunks(
    paths: SequenceOf[Path], columns: list[str], *, split: str | None, ids: Collection[str] | None, rows: int
) -> Iterator[SequenceChunk]:
    """Stream rows of Parquet files in order.

    Args:
        paths: The parts of one table.
        columns: What the chunks hold.
        split: Only this split; all if None.
        ids: Only the rows with these ``sequence_id``; all if None.
        rows: Largest number of rows read at once.
    """
    needed = [name for name, chosen in (("split", split), ("sequence_id", ids)) if chosen is not None]
    read = list(dict.fromkeys([*columns, *needed]))
    wanted: dict[str, list[str]] = {}
    if split is not None:
        wanted["split"] = [split]
    ordered = sorted(ids or ())
    if ids is not None:
        wanted["sequence_id"] = ordered
    for path in paths:
        with naming(path):
            file = open_parquet(path)
            groups = groups_that_may_hold(file.metadata, wanted)
            for batch in file.iter_batches(batch_size=rows, row_groups=groups, columns=read):
                if split is not None:
                    batch = _kept(batch, pc.call_function("equal", [batch.column("split"), pa.scalar(split)]))
                if ids is not None and batch.num_rows:
                    names = batch.column("sequence_id").to_pylist()
                    # Not Arrow's is_in, which builds its table of all ids anew for every batch.
                    near = set(ordered[bisect_left(ordered, min(names)) : bisect_right(ordered, max(names))])
                    batch = _kept(batch, pa.array([name in near for name in names]))
                if batch.num_rows:
                    yield SequenceChunk(batch.select(columns))


def groups_that_may_hold(metadata: pq.FileMetaData, wanted: Mapping[str, SequenceOf[str]]) -> list[int]:
    """Return the numbers of the row groups that may hold wanted rows, as the footer of a Parquet file tells.

    Args:
        metadata: The footer. It holds the smallest and the largest text of each column of every row group.
        wanted: Maps names of text columns to sorted values; a row is wanted if it has one of them in each column.
    """
    if not metadata.num_row_groups:
        return []
    first = metadata.row_group(0)
    # Not from `metadata.schema`: pyarrow then never frees the footer (a cycle that no collector sees).
    paths = [first.column(place).path_in_schema for place in range(metadata.num_columns)]
    places = {paths.index(name): values for name, values in wanted.items() if name in paths}
    chosen = []
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        for place, values in places.items():
            statistics = group.column(place).statistics
            # A file may lack the smallest and the largest text.
            if statistics is not None and statistics.has_min_max and isinstance(statistics.min, str):
                nearest = bisect_left(values, statistics.min)
                if nearest == len(values) or values[nearest] > statistics.max:
                    break
        else:
            chosen.append(number)
    return chosen


@contextlib.contextmanager
def naming(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into an error that names it; bytes may be damaged anywhere."""
    with bounded.foreign_input(path):
        try:
            yield
        except FileNotFoundError as error:
            raise TableError(f"{path}: expected a Parquet file, found none.") from error
        except (pa.ArrowException, OSError) as error:
            # MemoryError of Arrow is an ArrowException too, and the file is not to blame for it.
            if isinstance(error, MemoryError):
                raise
            first = str(error).splitlines()[0] if str(error) else "damaged"
            raise TableError(f"{path}: not a readable Parquet file ({first}). Build the dataset again.") from error


def open_parquet(path: Path) -> pq.ParquetFile:
    """Return a Parquet file, opened.

    Raises:
        TableError: if it is missing or damaged.
    """
    with naming(path):
        return arrays.open_parquet(path)


def read_parquet(path: Path, columns: list[str]) -> pa.Table:
    """Return some columns of a Parquet file.

    Raises:
        TableError: if it is missing or damaged.
    """
    with naming(path):
        return arrays.read_parquet(path, columns)


def require_distinct(ids: SequenceOf[str], where: Path | str) -> None:
    """Refuse rows of one id: which of them is meant would depend on their order, and counts would count them twice.

    Raises:
        TableError: naming the first repeated id.
    """
    repeated = first_repeated(ids)
    if repeated is not None:
        remedy = "Build the dataset again."
        raise TableError(f"{where}: expected rows with different ids, found '{quoted(repeated)}' twice. {remedy}")


def require_distinct_rows(paths: SequenceOf[Path], column: str, where: Path | str) -> None:
    """Refuse rows of one id in a column of Parquet files; sorted rows are looked at a batch at a time.

    Raises:
        TableError: naming the first repeated id, or the file that is missing or damaged.
    """
    last = ""
    for path in paths:
        with naming(path):
            for batch in open_parquet(path).iter_batches(batch_size=1024, columns=[column]):
                names = [last, *batch.column(0).to_pylist()]
                if any(name <= before for before, name in pairwise(names)):  # any two rows have to be compared
                    tables = [read_parquet(each, [column]) for each in paths]
                    return require_distinct(pa.concat_tables(tables)[column].to_pylist(), where)
                last = names[-1]
    return None


def _kept(batch: pa.RecordBatch, wanted: pa.BooleanArray) -> pa.RecordBatch:
    """Return the wanted rows; without a copy where these are all."""
    return batch if wanted.true_count == len(wanted) else batch.filter(wanted)


def is_bulky(kind: pa.DataType) -> bool:
    """Return True if a column holds per-frame values or whole poses."""
    return pa.types.is_list(kind) or (pa.types.is_fixed_size_list(kind) and kind.list_size > 16)
