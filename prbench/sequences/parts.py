"""Intermediate parts of a build: one folder a unit of work, kept until the tables stand, so that a build resumes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from prbench.engine.shards import code_digest
from prbench.files.storage import atomic_folder, read_json, remove_folder, remove_leftovers, text_digest, write_json

_RECEIPT = "receipt.json"


def work_folder(out: Path) -> Path:
    """The folder of parts that belongs to the folder of a result; it stands beside it."""
    return out.parent / f".{out.name}.work"


def part_folder(work: Path, name: str, input_digest: str, settings: str) -> Path:
    """Return the folder of one part: another input, option or version of the code is another folder."""
    return work / text_digest(name, input_digest, settings, code_digest())[:32]


def write_part(folder: Path, batches: Mapping[str, pa.RecordBatch], receipt: Mapping[str, object]) -> None:
    """Write one part, whole or not at all: a batch of rows for each table, and what tells of it without opening one."""
    with atomic_folder(folder, told_by=_RECEIPT) as temporary:
        for name, batch in batches.items():
            with pa.OSFile(str(temporary / f"{name}.arrow"), "wb") as sink, pa.ipc.new_file(sink, batch.schema) as file:
                file.write_batch(batch)
        write_json(temporary / _RECEIPT, receipt)


def plain(receipt: object) -> Any:
    """A receipt as JSON knows it; numbers that a reader has taken from arrays become plain ones."""

    def plain_number(value: object) -> object:
        if isinstance(value, np.generic):
            return value.item()
        raise NotImplementedError(f"{type(value).__name__} in a receipt")

    return msgspec.to_builtins(receipt, enc_hook=plain_number)


def read_receipt(folder: Path) -> dict | None:
    """Read the receipt that :func:`write_part` was given for a finished part; None if there is no such part."""
    if not (folder / _RECEIPT).is_file():
        return None
    entries = read_json(folder / _RECEIPT)
    assert isinstance(entries, dict)
    return entries


def read_batches(folders: Iterable[Path], table: str) -> Iterator[pa.RecordBatch]:
    """The rows of one table from parts, in their order; parts without rows are passed over."""
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
    remove_leftovers(work_folder(out))
    yield
    remove_folder(work_folder(out))
