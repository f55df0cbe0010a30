"""The part of one curated recording in a build that can be resumed (:mod:`prbench.sequences.parts`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pyarrow as pa

from prbench.curation.curate import CuratedRecording
from prbench.sequences import parts
from prbench.sequences.parts import part_folder
from prbench.sequences.schema import EVENTS, RECORDINGS, SEQUENCES
from prbench.sequences.sequence import RecordingRecord, event_batch, recording_batch, sequence_batch

__all__ = [
    "TABLES",
    "PartReceipt",
    "part_folder",
    "read_batches",
    "read_receipt",
    "write_part",
]

TABLES = {"sequences": SEQUENCES, "events": EVENTS, "recordings": RECORDINGS}


@dataclass(frozen=True)
class PartReceipt:
    """What a finished part tells without opening its tables."""

    folder: Path
    input_digest: str
    record: RecordingRecord
    reused: bool
    """Whether an earlier, interrupted build had made it."""


def write_part(folder: Path, curated: CuratedRecording, input_digest: str) -> PartReceipt:
    """Write one part, whole or not at all."""
    batches = {
        "sequences": sequence_batch(curated.sequences),
        "events": event_batch(curated.events),
        "recordings": recording_batch([curated.record]),
    }
    parts.write_part(folder, batches, {"input_digest": input_digest, "record": parts.plain(curated.record)})
    return PartReceipt(folder, input_digest, curated.record, reused=False)


def read_receipt(folder: Path) -> PartReceipt | None:
    """The receipt of a finished part, or None if there is no such part."""
    entries = parts.read_receipt(folder)
    if entries is None:
        return None
    record = msgspec.convert(entries["record"], RecordingRecord)
    return PartReceipt(folder, entries["input_digest"], record, reused=True)


def read_batches(receipts: list[PartReceipt], table: str) -> Iterator[pa.RecordBatch]:
    """The rows of one table from all parts, in the order of the receipts."""
    return parts.read_batches((receipt.folder for receipt in receipts), table)
