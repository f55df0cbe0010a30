"""A shard of a build on disk: the parts of its recordings, and a list of them that is written last.

Parts are those of :mod:`prbench.sequences.parts`, kept in the shard's own folder. While the list is missing, the shard
is unfinished, and the same command goes on. Source: docs/cluster.md#what-a-shard-holds.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import msgspec

from prbench.engine.shards import FILE_NAME, Shard, ShardRecord, begin_shard
from prbench.errors import ShardError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import file_digest, inside, remove_leftovers, require_replaceable, sole_writer, write_json
from prbench.limits import LARGEST_JSON
from prbench.sequences.parts import read_receipt

Record = TypeVar("Record")
_PARTS = "parts"
_FINISHED = "finished.json"


@dataclass(frozen=True)
class ShardReport(Generic[Record]):
    """The result of one shard of a build."""

    folder: Path
    shard: Shard
    planned: int
    """Recordings, or groups of them, of all shards."""
    records: tuple[Record, ...]
    """Recordings of this shard."""
    reused: int
    """Recordings taken over from an interrupted call."""


class _KeptPart(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One part of a finished shard."""

    place: int
    """Place of its item in the plan."""
    name: str
    folder: str
    files: dict[str, str]
    """SHA-256 of each file in the folder by its name."""


class _Finished(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole of ``finished.json``."""

    parts: tuple[_KeptPart, ...]


@contextlib.contextmanager
def making_shard(out: Path, record: ShardRecord) -> Iterator[Path]:
    """Hold the folder of a shard while its parts are made; yields the folder that they go to.

    The caller calls :func:`finish_shard` in the end.

    Raises:
        StorageError: if the folder holds something else, cannot be written, or another process writes there.
        ShardError: if it holds another shard.
    """
    with sole_writer(out):
        for name in (FILE_NAME, _FINISHED):
            remove_leftovers(out / name)
        require_replaceable(out, FILE_NAME, kind="shard")
        begin_shard(out, record)
        # A part that is made again must not look changed to a merge.
        (out / _FINISHED).unlink(missing_ok=True)
        yield out / _PARTS


def finish_shard(out: Path, record: ShardRecord, folders: Sequence[Path]) -> None:
    """Put down that all parts of a shard are there; whatever else lies among them goes.

    Args:
        out: The shard.
        record: What it is.
        folders: Of its parts, in the order of its items.
    """
    kept = []
    for place, folder in zip(record.shard.places(len(record.plan)), folders, strict=True):
        digests = {path.name: file_digest(path) for path in sorted(folder.iterdir())}
        kept.append(_KeptPart(place=place, name=record.plan[place], folder=folder.name, files=digests))
    names = {part.folder for part in kept}
    for left in (out / _PARTS).iterdir() if (out / _PARTS).is_dir() else ():
        if left.name not in names:
            shutil.rmtree(left, ignore_errors=True)
    write_json(out / _FINISHED, msgspec.to_builtins(_Finished(parts=tuple(kept))))


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
            parts = msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=_Finished).parts
        except FileNotFoundError as error:
            raise ShardError(f"{folder}: shard {record.shard} is not finished. {again}") from error
        except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ShardError(f"{path}: not a valid {path.name}: {error}. {again}") from error
        expected = [(place, record.plan[place]) for place in record.shard.places(len(record.plan))]
        if [(part.place, part.name) for part in parts] != expected:
            raise ShardError(f"{path}: does not list the parts of shard {record.shard}. {again}")
        for part in parts:
            place = inside(folder / _PARTS, part.folder)
            for name, digest in part.files.items():
                _require_unchanged(inside(place, name), digest, record, again)
            receipt = read_receipt(place)
            if receipt is None:
                raise ShardError(f"{place}: expected a finished part, found one without receipt. Make its shard again.")
            found[part.place] = place, receipt
    return [found[place] for place in sorted(found)]


def _require_unchanged(path: Path, digest: str, record: ShardRecord, again: str) -> None:
    try:
        found = file_digest(path)
    except FileNotFoundError:
        found = "no file"
    if found != digest:
        raise ShardError(
            f"{path}: expected the file that shard {record.shard} has written (SHA-256 {digest[:12]}…), found"
            f" {found[:12]}{'…' if len(found) > 12 else ''}. Copy the shard again; or {again.lower()}"
        )
