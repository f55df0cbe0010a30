"""Curate one recording and keep the result as a part: the unit of work of a build that can be resumed.

Parts are described in :mod:`prbench.sequences.parts`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from prbench.curation.curate import CuratedRecording, curate_recording, split_of
from prbench.curation.options import CurationOptions
from prbench.curation.sources import RecordingSource
from prbench.engine import is_out_of_memory
from prbench.errors import InputFileError, PrbenchError
from prbench.files.storage import text_digest
from prbench.protocol.manifests import BenchmarkProtocol, Manifest, digest_of
from prbench.sequences import parts
from prbench.sequences.sequence import Recording, event_batch, recording_batch, scene_batch, sequence_batch
from prbench.shown import quoted


@dataclass(frozen=True)
class PartReceipt:
    """Description of a finished part, readable without opening its tables."""

    folder: Path
    input_digest: str
    record: Recording
    reused: bool
    """True if an earlier, interrupted build had made it."""


def part_receipt(folder: Path, entries: Mapping[str, Any], *, reused: bool) -> PartReceipt:
    """Turn what stands in a finished part into its description."""
    return PartReceipt(folder, entries["input_digest"], msgspec.convert(entries["record"], Recording), reused)


@dataclass(frozen=True)
class CurationJob:
    """Reads and curates one recording and writes its part, unless that part is there already."""

    manifest: Manifest
    protocol: BenchmarkProtocol
    options: CurationOptions
    stop_on_error: bool
    work: Path

    def __call__(self, source: RecordingSource) -> PartReceipt:
        """Make the part of one recording."""
        try:
            digest = "" if source.skip_reason is not None else source.input_digest()
        except (OSError, InputFileError) as error:
            # No digest exists of what cannot be read; the part is tried again by the next build.
            return self._write(source, self._failed(source, error), "unreadable")
        folder = self._folder(source, digest)
        entries = parts.read_receipt(folder)
        if entries is not None:
            found = part_receipt(folder, entries, reused=True)
            if found.record.status != "failed":  # a failure may have passed: try again
                return found
        return self._write(source, self._curated(source), digest)

    def if_full(self, source: RecordingSource, error: PrbenchError) -> PartReceipt:
        """Make the part of a recording for which the memory does not suffice: it is not read, and says why."""
        return self._write(source, self._failed(source, error), source.input_digest())

    def _curated(self, source: RecordingSource) -> CuratedRecording:
        if source.skip_reason is not None:
            return self._left_out(source, "skipped", source.skip_reason)
        try:
            recording = source.read()
            return curate_recording(recording, self.manifest, self.protocol, self.options, split=source.split)
        except Exception as error:
            if is_out_of_memory(error):
                raise  # the engine tries again when nothing else is done beside it
            # Whatever one recording does, the others go on; its message reaches the user with the build's report.
            return self._failed(source, error)

    def _failed(self, source: RecordingSource, error: Exception) -> CuratedRecording:
        known = isinstance(error, PrbenchError)
        if self.stop_on_error:
            if known:
                raise error
            raise PrbenchError(f"{source.recording_id}: unexpected {type(error).__name__}: {quoted(error)}") from error
        message = str(error) if known else f"unexpected {type(error).__name__}: {quoted(error)}"
        return self._left_out(source, "failed", source.without_places(message))

    def _left_out(self, source: RecordingSource, status: str, message: str) -> CuratedRecording:
        name = source.recording_id
        split = source.split or split_of(name, name, self.manifest, self.protocol.splits)
        return CuratedRecording((), (), Recording(name, "unknown", split, name, 0.0, {}, status, message))

    def _folder(self, source: RecordingSource, input_digest: str) -> Path:
        settings = text_digest(
            digest_of(self.manifest), self.protocol.digest, msgspec.json.encode(self.options).decode()
        )
        return parts.part_folder(self.work, source.recording_id, input_digest, settings)

    def _write(self, source: RecordingSource, curated: CuratedRecording, input_digest: str) -> PartReceipt:
        folder = self._folder(source, input_digest)
        batches = {
            "sequences": sequence_batch(curated.sequences),
            "events": event_batch(curated.events),
            "recordings": recording_batch([curated.record]),
            "scenes": scene_batch(curated.boxes),
        }
        parts.write_part(folder, batches, {"input_digest": input_digest, "record": parts.plain(curated.record)})
        return PartReceipt(folder, input_digest, curated.record, reused=False)
