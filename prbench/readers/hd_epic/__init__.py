"""Reader of HD-EPIC (docs/specification/hd-epic.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.readers import AnnotationCounts
from prbench.readers.egoallo.bodies import body_model
from prbench.readers.egoallo.files import aria_inputs
from prbench.readers.found import RecordingFiles
from prbench.readers.hd_epic import files
from prbench.readers.hd_epic.annotations import count_annotations
from prbench.readers.hd_epic.files import HdEpicOptions, find_recordings, read_readings
from prbench.readers.hd_epic.to_recording import recording_from_hd_epic
from prbench.readers.three_point import attached
from prbench.recording import Recording

__all__ = ["READER", "HdEpicOptions", "HdEpicReader", "find_recordings", "read_readings"]


@dataclass(frozen=True)
class HdEpicReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "hd-epic"
    options: HdEpicOptions = HdEpicOptions()  # noqa: RUF009 (frozen)
    egoallo_inputs = staticmethod(aria_inputs)
    require_further = staticmethod(body_model)
    extents = staticmethod(files.extents)

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`prbench.readers.hd_epic.files.find_recordings`."""
        return find_recordings(root, self.options)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """See :class:`prbench.readers.Reader`."""
        manifest = load_manifest(self.dataset)
        if self.options.events_only:  # what a video lacks beside its annotations does not matter
            return recording_from_hd_epic(files.read_annotations(found), manifest, dataset=found.dataset)
        found.require_usable(found.skip_reason or manifest.why_bad(found.recording_id))
        read = recording_from_hd_epic(read_readings(found), manifest, dataset=found.dataset)
        return attached(read, found) if self.options.poses == "three-point" else read

    @foreign_input()
    def annotation_counts(self, recordings: Sequence[RecordingFiles]) -> AnnotationCounts | None:
        """See :class:`prbench.readers.CountsAnnotations`; all videos of the annotations, whichever lie on the disk."""
        first = recordings[0]
        associations = first.path(files.ASSOCIATIONS)
        if associations is None:
            return None
        published = {} if first.dataset != self.dataset else load_manifest(self.dataset).published_counts
        return count_annotations(associations, first.path(files.MASKS), first.path(files.PRIMING), published)


READER = HdEpicReader()
