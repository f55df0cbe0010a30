"""Builds in parts: one folder a unit of work, kept until the tables stand, so a build resumes; shards and reports."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec
import numpy as np
import pyarrow as pa

from prbench.engine.shards import FILE_NAME, Shard, ShardRecord, begin_shard, code_digest
from prbench.errors import ShardError
from prbench.files import storage
from prbench.files.bounded import foreign_input, read_whole
from prbench.limits import LARGEST_JSON

_RECEIPT = "receipt.json"


def work_folder(out: Path) -> Path:
    """Return the folder of parts that belongs to the folder of a result; it stands beside it."""
    return out.parent / f".{out.name}.work"


def part_folder(work: Path, name: str, input_digest: str, settings: str) -> Path:
    """Return the folder of one part: another input, option or version of the code is another folder."""
    return work / storage.text_digest(name, input_digest, settings, code_digest())[:32]


def write_part(folder: Path, batches: Mapping[str, pa.RecordBatch], receipt: Mapping[str, object]) -> None:
    """Write one part, whole or not at all: a batch of rows for each table, and what tells of it without opening one."""
    with storage.atomic_folder(folder, told_by=_RECEIPT) as temporary:
        for name, batch in batches.items():
            with pa.OSFile(str(temporary / f"{name}.arrow"), "wb") as sink, pa.ipc.new_file(sink, batch.schema) as file:
                file.write_batch(batch)
        storage.write_json(temporary / _RECEIPT, receipt)


def plain(receipt: object) -> Any:
    """Return a receipt as JSON knows it; numbers that a reader has taken from arrays become plain ones."""

    def plain_number(value: object) -> object:
        if isinstance(value, np.generic):
            return value.item()
        raise NotImplementedError(f"{type(value).__name__} in a receipt")

    return msgspec.to_builtins(receipt, enc_hook=plain_number)


def read_receipt(folder: Path) -> dict | None:
    """Read the receipt that :func:`write_part` was given for a finished part; None if there is no such part."""
    if not (folder / _RECEIPT).is_file():
        return None
    entries = storage.read_json(folder / _RECEIPT)
    assert isinstance(entries, dict)
    return entries


def read_batches(folders: Iterable[Path], table: str) -> Iterator[pa.RecordBatch]:
    """Yield the rows of one table from parts, in their order; parts without rows are passed over."""
    for folder in folders:
        with pa.OSFile(str(folder / f"{table}.arrow"), "rb") as source:
            for batch in pa.ipc.open_file(source).read_all().to_batches():
                if batch.num_rows:
                    yield batch


@contextlib.contextmanager
def working_in_parts(out: Path) -> Iterator[None]:
    """Clear away what a build that was killed half wrote, or half removed; delete all parts once the result stands.

    Finished parts stay when the block fails. They go all or none: half a part would look finished to the next build.
    """
    storage.remove_leftovers(work_folder(out))
    yield
    storage.remove_folder(work_folder(out))


Record = TypeVar("Record")
_Info = TypeVar("_Info")
_PARTS = "parts"
_FINISHED = "finished.json"


@dataclass(frozen=True)
class BuildReport(Generic[_Info, Record]):
    """One table that was written: of sequences, or a corpus.

    Attributes:
        folder: The table.
        info: The content of its ``dataset.json`` or ``corpus.json``: counts of each stage, outcomes, digests, terms.
        records: Every recording that was found, also those that could not be read.
        reused: Number of recordings that an interrupted build had already finished.
    """

    folder: Path
    info: _Info
    records: tuple[Record, ...]
    reused: int


@dataclass(frozen=True)
class BuildPlan:
    """The input of a build, found out without reading any recording.

    Attributes:
        dataset: Name of the dataset.
        root: The folder that would be read; null for a synthetic corpus.
        recordings: Names of the recordings.
        skipped: Those among them that are known to be bad and would be skipped.
        input_bytes: Size of the files to read, in bytes.
        estimated_seconds: Time that one worker would take on a machine like the one it was measured on, in seconds.
        estimated_disk_bytes: Space that the build would need, in bytes.
    """

    dataset: str
    root: Path | None
    recordings: tuple[str, ...]
    skipped: tuple[str, ...]
    input_bytes: int
    estimated_seconds: float
    estimated_disk_bytes: int


@dataclass(frozen=True)
class ShardReport(Generic[Record]):
    """The result of one shard of a build.

    Attributes:
        folder: Its folder, for ``prbench merge``.
        shard: Which one it is.
        planned: Number of recordings, or groups of them, of all shards.
        records: Recordings of this shard.
        reused: Number of recordings taken over from an interrupted call.
    """

    folder: Path
    shard: Shard
    planned: int
    records: tuple[Record, ...]
    reused: int


@contextlib.contextmanager
def making_shard(out: Path, record: ShardRecord) -> Iterator[Path]:
    """Hold the folder of a shard while its parts are made; yields the folder that they go to.

    The caller calls :func:`finish_shard` in the end.

    Raises:
        StorageError: if the folder holds something else, cannot be written, or another process writes there.
        ShardError: if it holds another shard.
    """
    with storage.sole_writer(out):
        for name in (FILE_NAME, _FINISHED):
            storage.remove_leftovers(out / name)
        storage.require_replaceable(out, FILE_NAME, kind="shard")
        begin_shard(out, record)
        # A part that is made again must not look changed to a merge.
        (out / _FINISHED).unlink(missing_ok=True)
        yield out / _PARTS


def finish_shard(out: Path, record: ShardRecord, folders: Sequence[Path]) -> None:
    """Put down that all parts of a shard are there; whatever else lies among them goes.

    Args:
        out: The shard.
        record: What it is.
        folders: Folders of its parts, in the order of its items.
    """
    kept = []
    for place, folder in zip(record.shard.places(len(record.plan)), folders, strict=True):
        digests = {path.name: storage.file_digest(path) for path in sorted(folder.iterdir())}
        kept.append((place, record.plan[place], folder.name, digests))
    names = {name for _, _, name, _ in kept}
    for left in (out / _PARTS).iterdir() if (out / _PARTS).is_dir() else ():
        if left.name not in names:
            shutil.rmtree(left, ignore_errors=True)
    storage.write_json(out / _FINISHED, kept)


# What ``finished.json`` holds of each part: place in the plan, name, folder, and SHA-256 of its files by name.
_Kept = list[tuple[int, str, str, dict[str, str]]]


@foreign_input()
def shard_parts(shards: Iterable[tuple[Path, ShardRecord]]) -> list[tuple[Path, dict]]:
    """Return folder and receipt of the parts of all shards of a build, in the order of its plan.

    Args:
        shards: All of them (:func:`prbench.engine.shards.require_whole`).

    Raises:
        ShardError: if one is unfinished, or a file of it is missing or changed.
    """
    found: dict[int, tuple[Path, dict]] = {}
    for folder, record in shards:
        again = f"Run its command (--shard {record.shard}) again."
        path = folder / _FINISHED
        try:
            parts = msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=_Kept)
        except FileNotFoundError as error:
            raise ShardError(f"{folder}: shard {record.shard} is not finished. {again}") from error
        except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ShardError(f"{path}: not a valid {path.name}: {error}. {again}") from error
        expected = [(place, record.plan[place]) for place in record.shard.places(len(record.plan))]
        if [part[:2] for part in parts] != expected:
            raise ShardError(f"{path}: does not list the parts of shard {record.shard}. {again}")
        for number, _, part_name, files in parts:
            place = storage.inside(folder / _PARTS, part_name)
            for name, digest in files.items():
                file = storage.inside(place, name)
                there = storage.file_digest(file) if file.is_file() else "no file"
                if there != digest:
                    why = f"(SHA-256 {digest[:12]}…), found {there[:12]}. Copy the shard again; or {again.lower()}"
                    raise ShardError(f"{file}: expected the file that shard {record.shard} has written {why}")
            receipt = read_receipt(place)
            if receipt is None:
                raise ShardError(f"{place}: expected a finished part, found one without receipt. Make its shard again.")
            found[number] = place, receipt
    return [found[place] for place in sorted(found)]
