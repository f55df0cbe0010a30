"""Intermediate parts of a build: one folder a recording, kept until the dataset is written, so that a build resumes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import msgspec
import pyarrow as pa

import prbench
from prbench.curation.curate import CuratedRecording
from prbench.sequences.schema import EVENTS, RECORDINGS, SCHEMA_VERSION, SEQUENCES
from prbench.sequences.sequence import RecordingRecord, event_batch, recording_batch, sequence_batch
from prbench.storage import atomic_folder, read_json, text_digest, write_json

TABLES = {"sequences": SEQUENCES, "events": EVENTS, "recordings": RECORDINGS}
_RECEIPT = "receipt.json"


@dataclass(frozen=True)
class PartReceipt:
    """What a finished part tells without opening its tables."""

    folder: Path
    input_digest: str
    record: RecordingRecord
    reused: bool
    """Whether an earlier, interrupted build had made it."""


def work_folder(out: Path) -> Path:
    """The folder of parts that belongs to a dataset folder; it stands beside it."""
    return out.parent / f".{out.name}.work"


def part_folder(work: Path, recording_id: str, input_digest: str, settings: str) -> Path:
    """Where the part of one recording lies: another input, option or version of the code is another folder."""
    return work / text_digest(recording_id, input_digest, settings, code_digest())[:32]


@cache
def code_digest() -> str:
    """Digest of the package's source files, so that parts made by other code are never taken over."""
    root = Path(prbench.__file__).parent
    digest = hashlib.sha256(f"{prbench.__version__} {SCHEMA_VERSION}".encode())
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def write_part(folder: Path, curated: CuratedRecording, input_digest: str) -> PartReceipt:
    """Write one part, whole or not at all."""
    batches = {
        "sequences": sequence_batch(curated.sequences),
        "events": event_batch(curated.events),
        "recordings": recording_batch([curated.record]),
    }
    with atomic_folder(folder) as temporary:
        for name, batch in batches.items():
            with pa.OSFile(str(temporary / f"{name}.arrow"), "wb") as sink, pa.ipc.new_file(sink, batch.schema) as file:
                file.write_batch(batch)
        write_json(temporary / _RECEIPT, {"input_digest": input_digest, "record": msgspec.to_builtins(curated.record)})
    return PartReceipt(folder, input_digest, curated.record, reused=False)


def read_receipt(folder: Path) -> PartReceipt | None:
    """The receipt of a finished part, or None if there is no such part."""
    if not (folder / _RECEIPT).is_file():
        return None
    entries = read_json(folder / _RECEIPT)
    assert isinstance(entries, dict)
    record = msgspec.convert(entries["record"], RecordingRecord)
    return PartReceipt(folder, entries["input_digest"], record, reused=True)


def read_batches(receipts: list[PartReceipt], table: str) -> Iterator[pa.RecordBatch]:
    """The rows of one table from all parts, in the order of the receipts; parts without rows are passed over."""
    for receipt in receipts:
        with pa.OSFile(str(receipt.folder / f"{table}.arrow"), "rb") as source:
            for batch in pa.ipc.open_file(source).read_all().to_batches():
                if batch.num_rows:
                    yield batch
