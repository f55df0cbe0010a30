"""Reader of HD-EPIC (docs/specification/hd-epic.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.readers.egoallo.files import aria_inputs
from prbench.readers.extents import Extent
from prbench.readers.found import RecordingFiles
from prbench.readers.hd_epic.files import HdEpicOptions, extents, find_recordings, read_readings
from prbench.readers.hd_epic.to_recording import recording_from_hd_epic
from prbench.recording import Recording

__all__ = ["READER", "HdEpicOptions", "HdEpicReader", "find_recordings", "read_readings"]


@dataclass(frozen=True)
class HdEpicReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "hd-epic"
    options: HdEpicOptions = HdEpicOptions()  # noqa: RUF009 (frozen)
    egoallo_inputs = staticmethod(aria_inputs)

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`prbench.readers.hd_epic.files.find_recordings`."""
        return find_recordings(root, self.options)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """See :class:`prbench.readers.Reader`."""
        manifest = load_manifest(self.dataset)
        found.require_usable(found.skip_reason or manifest.why_bad(found.recording_id))
        readings = read_readings(found)
        return recording_from_hd_epic(readings, manifest, dataset=found.dataset)

    def extents(self, found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:
        """See :class:`prbench.readers.KnowsEnds`."""
        return extents(found, recording)


READER = HdEpicReader()
