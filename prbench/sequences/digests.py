"""The two digests of a sequence table: identity (which sequences) and content (which values)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from collections.abc import Sequence as SequenceOf

import numpy as np
import pyarrow as pa

from prbench.sequences.schema import SEQUENCES, SEQUENCES_VERSION

_ROUNDING = 1e-5  # metres, seconds and unit vectors alike: 10 micrometres


def identity_digest(
    sequence_ids: list[str], splits: list[str], actions: list[str], n_frames: Iterable[int], *, protocol_version: int
) -> str:
    """What two laboratories with the same licensed data share: ids with split, action and length, in sorted order."""
    digest = hashlib.sha256(f"prbench schema {SEQUENCES_VERSION} protocol {protocol_version}\n".encode())
    for row in sorted(zip(sequence_ids, splits, actions, (str(n) for n in n_frames))):
        digest.update("\t".join(row).encode() + b"\n")
    return digest.hexdigest()


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
        self._presence, self._lengths, self._values = hashlib.sha256(), hashlib.sha256(), hashlib.sha256()

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
    return np.rint(numbers * np.float64(1 / _ROUNDING)).astype(integer)
