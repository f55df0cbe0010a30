"""``training.json``: what decides the result of a training, so that a folder never mixes two of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import msgspec

from prbench.errors import StorageError, TrainingError
from prbench.sequences import CorpusTable, SequenceTable
from prbench.storage import read_json, remove_leftovers, write_json
from prbench.training.configuration import TrainingConfiguration

RECORD = "training.json"
SCHEMA_VERSION = 1
_MAY_CHANGE = frozenset({"configuration.training.save_every", "configuration.training.log_every"})


class TableRecord(msgspec.Struct, frozen=True, kw_only=True):
    """One table that was learnt from."""

    dataset: str
    title: str
    synthetic: bool
    licence: str
    identity_digest: str
    content_digest: str
    sequences: int
    """Number of sequences in the split that is trained on."""


class TrainingRecord(msgspec.Struct, frozen=True, kw_only=True):
    """Everything that decides the result, except code and machine."""

    schema_version: int = SCHEMA_VERSION
    method: str
    stage: str
    configuration: TrainingConfiguration
    data: tuple[TableRecord, ...]
    initial_weights_sha256: str | None
    devices: int


def table_records(tables: Iterable[SequenceTable | CorpusTable], *, split: str) -> tuple[TableRecord, ...]:
    """Describe each table for the card, in the order given (the order decides what a seed draws)."""
    return tuple(
        TableRecord(
            dataset=table.info.dataset,
            title=table.info.title,
            synthetic=table.info.synthetic,
            licence=table.info.licence,
            identity_digest=table.info.identity_digest,
            content_digest=table.info.content_digest,
            sequences=table.scalars(split=split).num_rows,
        )
        for table in tables
    )


def require_same_training(out: Path, record: TrainingRecord) -> None:
    """Refuse a folder that belongs to something else, before hours of work.

    Raises:
        TrainingError: if it belongs to another training; names the first key that differs.
        StorageError: if it holds something else.
    """
    path = out / RECORD
    remove_leftovers(path)  # of a process that was killed before the file stood there
    if not path.is_file():
        if out.is_file() or (out.is_dir() and any(out.iterdir())):
            raise StorageError(
                f"{out}: is not empty and holds no {RECORD}, so it is no training that could go on."
                " Choose an empty or new folder for --out."
            )
        return
    found = read_json(path)
    if not isinstance(found, Mapping):
        raise TrainingError(f"{path}: expected the record of a training. Choose another folder for --out.")
    difference = first_difference(_flat(msgspec.to_builtins(record)), _flat(found))
    if difference is not None:
        key, now, then = difference
        raise TrainingError(
            f"{out}: holds another training: '{key}' is {then} there, but {now} was asked for."
            " Repeat the command of that training to go on with it, or choose another folder for --out."
        )


def write_record(out: Path, record: TrainingRecord) -> None:
    """Mark a folder as that of a training.

    Raises:
        StorageError: if it cannot be written.
    """
    write_json(out / RECORD, msgspec.to_builtins(record))


def first_difference(asked: Mapping[str, str], found: Mapping[str, str]) -> tuple[str, str, str] | None:
    """The first key, as asked and as found, whose value differs; None if all agree."""
    for key in dict.fromkeys((*asked, *found)):
        now, then = asked.get(key, "nothing"), found.get(key, "nothing")
        if now != then and key not in _MAY_CHANGE:
            return key, now, then
    return None


def _flat(value: Any, prefix: str = "") -> dict[str, str]:
    """Nested tables and lists as one level of dotted keys, values as JSON."""
    if isinstance(value, Mapping):
        parts = [_flat(item, f"{prefix}{key}.") for key, item in value.items()]
    elif isinstance(value, list | tuple):
        parts = [_flat(item, f"{prefix}{place}.") for place, item in enumerate(value)]
    else:
        return {prefix.rstrip("."): msgspec.json.encode(value).decode()}
    return {key: text for part in parts for key, text in part.items()}
