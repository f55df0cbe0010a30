"""Open a built dataset and stream its tables."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from prbench.errors import TableError
from prbench.sequences.chunk import SequenceChunk
from prbench.sequences.dataset_info import DatasetInfo
from prbench.sequences.digests import ContentDigest, identity_digest
from prbench.sequences.schema import EVENTS, RECORDINGS, SEQUENCES, check_schema

SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class SequenceTable:
    """A built dataset: its folder, its provenance, and its rows on demand."""

    folder: Path
    info: DatasetInfo

    @classmethod
    def open(cls, folder: Path) -> SequenceTable:
        """Open a dataset folder and check versions, columns and that it holds sequences.

        Raises:
            TableError: naming the file, what was expected and what was found.
        """
        table = cls(folder, DatasetInfo.read(folder))
        rows = 0
        for path in table.part_paths("sequences"):
            file = _open_parquet(path)
            check_schema(file.schema_arrow, SEQUENCES, source=str(path))
            rows += file.metadata.num_rows
        if rows == 0:
            raise TableError(
                f"{folder}: the sequence table is empty. `{folder / 'dataset.json'}` holds the funnel that says why;"
                " `prbench explain` tells the story of single events."
            )
        return table

    def part_paths(self, name: str) -> list[Path]:
        """The Parquet files of ``sequences``, ``events`` or ``recordings``, in order."""
        return table_parts(self.folder, name)

    def chunks(
        self,
        *,
        split: str | None = None,
        columns: SequenceOf[str] | None = None,
        ids: frozenset[str] | None = None,
        rows: int = 256,
    ) -> Iterator[SequenceChunk]:
        """Stream rows in table order.

        Args:
            split: Only this split.
            columns: Only these columns; ``sequence_id`` and ``n_frames`` always come along.
            ids: Only these sequences.
            rows: Largest number of rows read at once.
        """
        wanted = list(SEQUENCES.names if columns is None else dict.fromkeys(["sequence_id", "n_frames", *columns]))
        read = [*wanted, "split"] if split is not None and "split" not in wanted else wanted
        of_split, known = pa.array([split], type=pa.string()), pa.array(sorted(ids or ()), type=pa.string())
        for path in self.part_paths("sequences"):
            with _naming(path):
                for batch in _open_parquet(path).iter_batches(batch_size=rows, columns=read):
                    if split is not None:
                        batch = _kept(batch, "split", of_split)
                    if ids is not None:
                        batch = _kept(batch, "sequence_id", known)
                    if batch.num_rows:
                        yield SequenceChunk(batch.select(wanted))

    def scalars(self, *, split: str | None = None) -> pa.Table:
        """All columns that hold one short value a row (no per-frame values, no poses)."""
        names = [field.name for field in SEQUENCES if not _is_bulky(field.type)]
        table = pa.concat_tables(_read_parquet(path, names) for path in self.part_paths("sequences"))
        if split is not None:
            table = table.filter(pc.field("split") == split)
        return table.combine_chunks()

    def events(self) -> pa.Table:
        """The ``events`` table."""
        return self._read("events", EVENTS)

    def recordings(self) -> pa.Table:
        """The ``recordings`` table."""
        return self._read("recordings", RECORDINGS)

    @cached_property
    def identity(self) -> str:
        """Identity digest, computed from the rows."""
        rows = self.scalars()
        return identity_digest(
            rows["sequence_id"].to_pylist(),
            rows["split"].to_pylist(),
            rows["action"].to_pylist(),
            rows["n_frames"].to_pylist(),
            protocol_version=self.info.protocol_version,
        )

    @cached_property
    def content(self) -> str:
        """Content digest, computed from the rows.

        Raises:
            TableError: if the rows are no longer those that the dataset was built with.
        """
        digest = ContentDigest()
        for chunk in self.chunks():
            digest.update(chunk.batch)
        if digest.hexdigest() != self.info.content_digest:
            raise TableError(
                f"{self.folder}: the sequences are not the ones that dataset.json describes"
                f" (content digest {digest.hexdigest()[:12]}…, expected {self.info.content_digest[:12]}…)."
                " A file was changed after the build; build the dataset again."
            )
        return digest.hexdigest()

    def _read(self, name: str, schema: pa.Schema) -> pa.Table:
        tables = []
        for path in self.part_paths(name):
            file = _open_parquet(path)
            check_schema(file.schema_arrow, schema, source=str(path))
            with _naming(path):
                tables.append(file.read())
        return pa.concat_tables(tables)


def table_parts(folder: Path, name: str) -> list[Path]:
    """The Parquet files of one table: a single file, or the parts of a folder in order.

    Raises:
        TableError: if neither exists.
    """
    single, parts = folder / f"{name}.parquet", folder / name
    if single.is_file():
        return [single]
    found = sorted(parts.glob("part-*.parquet"))
    if not found:
        raise TableError(f"{folder}: expected {name}.parquet or {name}/part-*.parquet, found neither.")
    return found


def smallest_by_hash(sequence_ids: SequenceOf[str], limit: int) -> list[str]:
    """The ``limit`` ids with the smallest SHA-256, so that every recording has its share; in the order given."""
    chosen = set(sorted(sequence_ids, key=lambda name: hashlib.sha256(name.encode()).digest())[:limit])
    return [name for name in sequence_ids if name in chosen]


@contextlib.contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn what goes wrong while a file is read into an error that names it; bytes may be damaged anywhere."""
    try:
        yield
    except FileNotFoundError as error:
        raise TableError(f"{path}: expected a Parquet file, found none.") from error
    except (pa.ArrowInvalid, OSError) as error:
        first = str(error).splitlines()[0] if str(error) else "damaged"
        raise TableError(f"{path}: not a readable Parquet file ({first}). Build the dataset again.") from error


def _open_parquet(path: Path) -> pq.ParquetFile:
    with _naming(path):
        return pq.ParquetFile(path)


def _read_parquet(path: Path, columns: list[str]) -> pa.Table:
    with _naming(path):
        return pq.read_table(path, columns=columns)


def _kept(batch: pa.RecordBatch, column: str, values: pa.Array) -> pa.RecordBatch:
    """The rows whose ``column`` is one of ``values``; without a copy where these are all."""
    wanted = pc.call_function("is_in", [batch.column(column)], pc.SetLookupOptions(values))
    return batch if wanted.true_count == len(wanted) else batch.filter(wanted)


def _is_bulky(kind: pa.DataType) -> bool:
    return pa.types.is_list(kind) or (pa.types.is_fixed_size_list(kind) and kind.list_size > 16)
