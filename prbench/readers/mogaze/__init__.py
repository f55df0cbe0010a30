"""Reader of MoGaze (docs/specification/mogaze.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.readers import ReaderOptions
from prbench.readers.found import RecordingFiles
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.files import extents, find_recordings, read_readings
from prbench.readers.mogaze.to_recording import published_tracks, recording_from_mogaze
from prbench.recording import PublishedTrack, Recording

__all__ = ["READER", "MogazeOptions", "MogazeReader", "find_recordings", "read_readings"]


class MogazeOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the reader of MoGaze.

    Attributes:
        include_excluded: Keep recordings that the manifest leaves out for poor gaze (p7_2).
    """

    include_excluded: bool = False


@dataclass(frozen=True)
class MogazeReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "mogaze"
    options: MogazeOptions = MogazeOptions()  # noqa: RUF009 (frozen)
    extents = staticmethod(extents)
    native_joints = "mogaze21"

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`prbench.readers.mogaze.files.find_recordings`."""
        return find_recordings(root, include_excluded=self.options.include_excluded)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """See :class:`prbench.readers.Reader`."""
        return self._read(found)[1]

    @foreign_input()
    def read_published(self, found: RecordingFiles, *, native: bool) -> tuple[Recording, tuple[PublishedTrack, ...]]:
        """See :class:`prbench.readers.PublishedForPrediction`."""
        readings, recording = self._read(found)
        least = load_manifest("mogaze").thresholds["gaze_confidence"]
        tracks = published_tracks(readings, recording, least_confidence=least)
        return recording, tracks if native else tuple(replace(track, joints=track.body) for track in tracks)

    def _read(self, found: RecordingFiles) -> tuple[mogaze.MogazeReadings, Recording]:
        manifest = load_manifest("mogaze")
        found.require_usable(manifest.why_bad(found.recording_id))
        readings = read_readings(found, manifest)
        return readings, recording_from_mogaze(readings, manifest, dataset=found.dataset)


READER = MogazeReader()
