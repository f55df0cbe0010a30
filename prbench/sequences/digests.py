"""Digests of a table's rows and files, and the check that nobody edited a file after the build.

The identity digest says which sequences a table holds, the content digest says which values. ``dataset.json`` and
``corpus.json`` also hold the SHA-256 of every Parquet file beside them. Hashing costs 0.25 s for 10,000 sequences, so
it is done whenever a table is opened, and nothing is remembered that an edit could get past. A main table whose bytes
differ is compared value by value before it is refused: written anew with equal values it is still the same table.
Tables of earlier versions have no such digests: there the values of the main table decide, and a warning says that
nothing vouches for the others.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Sequence as SequenceOf
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from prbench.errors import TableError
from prbench.files.storage import file_digest
from prbench.sequences.schema import SEQUENCES, SEQUENCES_VERSION

_ROUNDING = 1e-5  # metres, seconds and unit vectors alike: 10 micrometres
_SHOWN = 12  # characters of a digest


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


class RowDigests:
    """Passes the rows of a main table on, and remembers what its two digests need.

    Args:
        columns: Every column of the table, for the content digest.
        identity_columns: The columns of :func:`identity_of_rows`, in its order.
    """

    def __init__(self, columns: SequenceOf[str], identity_columns: SequenceOf[str]) -> None:
        self.content = ContentDigest(columns)
        self._identity_columns = list(identity_columns)
        self._identifying: list[pa.RecordBatch] = []

    def pass_on(self, batches: Iterable[pa.RecordBatch]) -> Iterator[pa.RecordBatch]:
        """Yield the batches unchanged; the digests are those of what was taken so far."""
        for batch in batches:
            self.content.update(batch)
            self._identifying.append(batch.select(self._identity_columns))
            yield batch

    def identity(self, protocol_version: int) -> str:
        """The identity digest of all rows that were passed on."""
        rows = pa.table({name: pa.array([], pa.string()) for name in self._identity_columns})
        if self._identifying:
            rows = pa.Table.from_batches(self._identifying)
        return identity_of_rows(rows, protocol_version=protocol_version)


class ContentDigest:
    """Digest of the values, rounded to 10 µm, in the order of the rows; not of the file's bytes."""

    def __init__(self, columns: SequenceOf[str] = tuple(SEQUENCES.names)) -> None:
        self._columns = {name: _ColumnDigest() for name in columns}

    def update(self, batch: pa.RecordBatch) -> None:
        """Take up rows; how they are cut into batches leaves no trace."""
        for name, column in self._columns.items():
            column.update(batch.column(name))

    def hexdigest(self) -> str:
        """SHA-256 over the digests of the columns."""
        total = hashlib.sha256()
        for name, column in self._columns.items():
            total.update(name.encode() + column.digest())
        return total.hexdigest()


class _ColumnDigest:
    """Presence, lengths and values of one column, each a stream of its own so that batch borders do not show."""

    def __init__(self) -> None:
        self._presence = hashlib.sha256()
        self._lengths = hashlib.sha256()
        self._values = hashlib.sha256()

    def update(self, column: pa.Array) -> None:
        self._presence.update(np.asarray(column.is_valid(), dtype=np.uint8).tobytes())
        kind = column.type
        if pa.types.is_string(kind) or (pa.types.is_list(kind) and pa.types.is_struct(kind.value_type)):
            for value in column.to_pylist():
                self._values.update(repr(value).encode() + b"\n")
            return
        if pa.types.is_list(kind):
            self._lengths.update(np.asarray(column.value_lengths().fill_null(0), dtype=np.int64).tobytes())
            column = column.flatten()
        if pa.types.is_fixed_size_list(column.type):
            column = column.flatten()
        self._values.update(_rounded(column).tobytes())

    def digest(self) -> bytes:
        return self._presence.digest() + self._lengths.digest() + self._values.digest()


def _rounded(leaf: pa.Array) -> np.ndarray:
    """Integers that stand for the values: multiples of 10 µm for floats (32 bits hold 21 km)."""
    if pa.types.is_boolean(leaf.type):
        return np.asarray(leaf.fill_null(False), dtype=np.uint8)
    numbers = np.asarray(leaf.fill_null(0) if leaf.null_count else leaf)
    if not pa.types.is_floating(leaf.type):
        return numbers.astype(np.int64)
    integer = np.int32 if leaf.type == pa.float32() else np.int64
    # A product, not a quotient, and in float64: other processors then round to the same integers.
    return np.rint(numbers * np.float64(1 / _ROUNDING)).astype(integer)


class UnverifiedTableWarning(UserWarning):
    """Some files of a table have no digest, so that an edit of them would go unnoticed."""


def digests_of_files(folder: Path, tables: Iterable[str]) -> dict[str, str]:
    """SHA-256 of each Parquet file of some tables, by its path relative to the folder; absent files are left out."""
    paths = [path for name in tables for path in files_of_table(folder, name)]
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in paths}


def require_unchanged(
    folder: Path,
    described_in: Path,
    expected: Mapping[str, str],
    *,
    main: str,
    others: Iterable[str],
    require_same_values: Callable[[], object],
) -> None:
    """Refuse a table of which a file was edited.

    Args:
        folder: Holds the Parquet files.
        described_in: ``dataset.json`` or ``corpus.json``.
        expected: The digests that stand in there, by relative path; empty in tables of earlier versions.
        main: Name of the table whose values the content digest is of.
        others: Names of the further tables; where one is absent, whoever wants to read it says so.
        require_same_values: Compares the values of the main table with the content digest and raises the error.

    Raises:
        TableError: naming the first file that was edited.
    """
    if not expected:
        require_same_values()
        there = [name for name in others if files_of_table(folder, name)]
        warnings.warn(
            f"{described_in}: was written by an earlier version, without digests of {' and '.join(there)}, so"
            " these are unverified. Build it again to have edits of them noticed.",
            UnverifiedTableWarning,
            stacklevel=4,
        )
        return
    if digests_of_files(folder, [main]) != _of_table(expected, main):
        require_same_values()
    for name in others:
        for path, found in digests_of_files(folder, [name]).items():
            if found != expected.get(path):
                described = f"SHA-256 {expected[path][:_SHOWN]}…" if path in expected else "no such file"
                raise TableError(
                    f"{folder / path}: expected the file that {described_in.name} describes ({described}), found"
                    f" another one ({found[:_SHOWN]}…). It was changed after the build: copy the folder again, or build"
                    " it again."
                )


def files_of_table(folder: Path, table: str) -> list[Path]:
    """The Parquet file of a table, or the parts of a folder in order; none where it is absent."""
    single = folder / f"{table}.parquet"
    return [single] if single.is_file() else sorted((folder / table).glob("part-*.parquet"))


def _of_table(digests: Mapping[str, str], table: str) -> dict[str, str]:
    return {path: digest for path, digest in digests.items() if path.split("/")[0].removesuffix(".parquet") == table}
