"""Shards: a build or run in parts that know nothing of one another, made on several machines and merged afterwards.

A shard's folder holds ``shard.json``, which says what it is a shard of. Which items of the sorted plan (recordings,
batches) belong to a shard follows from the plan and the number of shards alone. Source: docs/cluster.md.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec

import prbench
from prbench.errors import ShardError, UsageError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import write_bytes
from prbench.limits import LARGEST_JSON
from prbench.shown import clean, quoted

FILE_NAME = "shard.json"
Kind = Literal["dataset", "corpus", "windows", "run"]
_Setting = TypeVar("_Setting")
_SCHEMA_VERSION = 1
# Missing shards that a message names.
_SHOWN = 8


@dataclass(frozen=True)
class Shard:
    """One of several shards, such as ``3/16``.

    Attributes:
        number: Number of the shard, from 1 on.
    """

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read a text such as ``3/16``.

        Raises:
            UsageError: for another text, or a shard that does not exist.
        """
        number, _, count = text.partition("/")
        # Few digits, so that no number is too long for Python to read.
        numbers = all(part.isascii() and part.isdecimal() and len(part) <= 6 for part in (number, count))
        if not numbers or not 1 <= int(number) <= int(count):
            raise UsageError(f"--shard {clean(text)}: expected K/N with K from 1 to N, such as 3/16.")
        return cls(int(number), int(count))

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def places(self, items: int) -> list[int]:
        """Return the places of the shard's items in a plan.

        Items are dealt out back and forth (1 2 3, 3 2 1, 1 2 3, …): a plan may be sorted by size, and then no shard
        gets the largest of every round.

        Args:
            items: Number of items of the plan.
        """
        places = []
        for start in range(0, items, self.count):
            there = (start // self.count) % 2 == 0
            place = start + (self.number - 1 if there else self.count - self.number)
            if place < items:
                places.append(place)
        return places


class ShardRecord(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole of ``shard.json``. Holds no time of day, host or worker count; of a run the places of its tables.

    Attributes:
        code_digest: Digest of prbench's source files, which may differ where the version does not.
        settings: What decides the result beside the items.
        plan: Names of all items of all shards, in order.
        places: Folders or URLs of a run's tables, so that they need not be named again; never compared.
    """

    schema_version: int = _SCHEMA_VERSION
    kind: Kind
    number: int
    count: int
    prbench_version: str = prbench.__version__
    code_digest: str = msgspec.field(default_factory=lambda: code_digest())
    settings: dict[str, Any]
    plan: tuple[str, ...]
    places: dict[str, Any] = {}

    @classmethod
    def of(cls, kind: Kind, shard: Shard, settings: dict[str, Any], plan: Iterable[str]) -> ShardRecord:
        """Return the record of one shard of a build."""
        return cls(kind=kind, number=shard.number, count=shard.count, settings=settings, plan=tuple(plan))

    @property
    def shard(self) -> Shard:
        """Which one it is."""
        return Shard(self.number, self.count)

    def write(self, folder: Path) -> None:
        """Write ``shard.json``; keys keep their order, so that the first that differs is the most telling one."""
        write_bytes(folder / FILE_NAME, msgspec.json.format(msgspec.json.encode(self), indent=2) + b"\n")

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> ShardRecord:
        """Read ``shard.json``.

        Raises:
            ShardError: if the folder holds none, or it is damaged or of another version.
        """
        path = folder / FILE_NAME
        try:
            record = msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=cls)
        except (FileNotFoundError, NotADirectoryError) as error:
            problem = f"expected a shard (a folder with {FILE_NAME}, from --shard K/N), found no such file in it."
            raise ShardError(f"{folder}: {problem}") from error
        except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ShardError(f"{path}: not a valid {FILE_NAME}: {error}. Make the shard again.") from error
        if record.schema_version != _SCHEMA_VERSION:
            found = f"found {record.schema_version}. Make the shard again, with the version of prbench that merges it."
            raise ShardError(f"{path}, schema_version: expected {_SCHEMA_VERSION}, {found}")
        if not 1 <= record.number <= record.count:
            raise ShardError(f"{path}: expected a shard K/N with K from 1 to N, found {record.shard}.")
        return record

    def setting(self, folder: Path, kind: type[_Setting], name: str = "") -> _Setting:
        """Return one of the settings, or all, as what it should be.

        Args:
            folder: Folder of the shard, for messages.
            kind: Type of the value.
            name: Key of the setting; empty for all.

        Raises:
            ShardError: if it is missing or something else.
        """
        try:
            return msgspec.convert(self.settings[name] if name else self.settings, kind)
        except (KeyError, msgspec.ValidationError) as error:
            where = f"{folder / FILE_NAME}, settings{name and f'.{name}'}"
            remedy = "Make the shard again."
            raise ShardError(f"{where}: expected those of a {self.kind}, found: {error}. {remedy}") from error

    def difference(self, other: ShardRecord) -> str | None:
        """Name the first thing in which another shard is of something else; None where both are of the same."""
        for name in ("kind", "prbench_version", "code_digest"):
            mine, theirs = getattr(self, name), getattr(other, name)
            if mine != theirs:
                return f"{name}: expected {_shown(mine)}, found {_shown(theirs)}"
        difference = _difference_of_settings(self.settings, other.settings)
        if difference is not None:
            return difference
        if self.plan != other.plan:
            # Say which item only one of the two holds: a node may lack a part of the data.
            lacking = sorted(set(self.plan) - set(other.plan))
            added = sorted(set(other.plan) - set(self.plan))
            numbers = f"plan: expected {len(self.plan)} items, found {len(other.plan)}"
            if lacking:
                return f"{numbers}, without '{quoted(lacking[0])}'"
            return f"{numbers}, with '{quoted(added[0])}'" if added else f"{numbers} in another order"
        if self.count != other.count:
            return f"number of shards: expected {self.count}, found {other.count}"
        return None


def begin_shard(folder: Path, wanted: ShardRecord) -> None:
    """Put ``shard.json`` into a folder, or go on in one that belongs to the very same shard.

    Raises:
        ShardError: if the folder belongs to another shard; names what differs.
    """
    if (folder / FILE_NAME).is_file():
        found = ShardRecord.read(folder)
        difference = wanted.difference(found)
        if difference is None and found.number != wanted.number:
            difference = f"shard: expected {wanted.shard}, found {found.shard}"
        if difference is not None:
            remedy = "The folder belongs to another shard; choose another folder for --out, or delete this one."
            raise ShardError(f"{folder / FILE_NAME}, {difference}. {remedy}")
    # Also where it is there: the tables may have moved.
    wanted.write(folder)


def require_whole(folders: Sequence[Path]) -> list[tuple[Path, ShardRecord]]:
    """Open the shards of one build or run, in their order.

    Args:
        folders: All of its shards, in any order.

    Raises:
        ShardError: if one is no shard, is of something else than the first, is there twice, or is missing.
    """
    shards = [(folder, ShardRecord.read(folder)) for folder in folders]
    first_folder, first = shards[0]
    by_number: dict[int, tuple[Path, ShardRecord]] = {}
    for folder, record in shards:
        difference = first.difference(record)
        if difference is not None:
            problem = "All shards are made by the same command with the same prbench on the same data"
            advice = "make the shard that is wrong again."
            raise ShardError(f"{folder / FILE_NAME}, {difference}, unlike {first_folder}. {problem}; {advice}")
        if record.number in by_number:
            why = f"is shard {record.shard}, and so is {by_number[record.number][0]}. Name each shard once."
            raise ShardError(f"{folder}: {why}")
        by_number[record.number] = (folder, record)
    missing = [number for number in range(1, first.count + 1) if number not in by_number]
    if missing:
        named = ", ".join(f"{number}/{first.count}" for number in missing[:_SHOWN])
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        remedy = "Make them with the command of the others and their --shard."
        raise ShardError(f"expected all {first.count} shards, found {len(by_number)}: {named}{more} missing. {remedy}")
    if first.prbench_version != prbench.__version__ or first.code_digest != code_digest():
        refusal = f"{first_folder / FILE_NAME}: the shards were made by prbench {clean(first.prbench_version)} (source"
        refusal += f" files {_shown(first.code_digest)}), and this is {prbench.__version__} ({_shown(code_digest())})."
        raise ShardError(f"{refusal} Merge them with the prbench that made them.")
    return [by_number[number] for number in sorted(by_number)]


_SAME = "Merge the shards with the prbench that made them."


def require_settings(folder: Path, record: ShardRecord, now: dict[str, Any], *, remedy: str = _SAME) -> None:
    """Refuse shards whose settings mean something else today, for example because a manifest was changed.

    Args:
        folder: Folder of the first shard.
        record: What it is.
        now: What its settings come to today.
        remedy: What to do.

    Raises:
        ShardError: naming the first one.
    """
    difference = _difference_of_settings(now, record.settings)
    if difference is not None:
        raise ShardError(f"{folder / FILE_NAME}, {difference}. {remedy}")


@cache
def code_digest() -> str:
    """Digest of the package's modules and tables, so that what other code has made is never taken over."""
    root = Path(prbench.__file__).parent
    # The version alone would not do: a working copy changes between releases.
    digest = hashlib.sha256(prbench.__version__.encode())
    for path in sorted((*root.rglob("*.py"), *root.rglob("*.toml"))):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def _difference_of_settings(mine: dict[str, Any], theirs: dict[str, Any]) -> str | None:
    wanted = flat_leaves(mine)
    found = flat_leaves(theirs)
    for key in wanted | found:
        if wanted.get(key) != found.get(key):
            return f"{key}: expected {_shown(wanted.get(key))}, found {_shown(found.get(key))}"
    return None


def flat_leaves(value: object, prefix: str = "") -> dict[str, object]:
    """Return the leaves of nested values by dotted key; entries of a list of tables are named by their dataset."""
    if isinstance(value, dict):
        items = [(str(key), item) for key, item in value.items()]
    elif isinstance(value, list | tuple):
        items = [(item["dataset"] if isinstance(item, dict) else str(i), item) for i, item in enumerate(value)]
    else:
        return {prefix: value}
    leaves: dict[str, object] = {}
    for key, item in items:
        leaves |= flat_leaves(item, f"{prefix}.{key}" if prefix else key)
    return leaves


def _shown(value: object) -> str:
    text = "nothing" if value is None else str(value)
    return f"{text[:12]}…" if len(text) == 64 else quoted(text)
