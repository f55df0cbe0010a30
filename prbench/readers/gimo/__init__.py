"""Reader of GIMO (docs/specification/gimo.md): every segment of ``dataset.csv`` is a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.readers import AnnotationLine
from prbench.readers.found import RecordingFiles
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.files import GimoOptions, extents, find_segments, open_route, read_readings, row_of
from prbench.readers.gimo.to_recording import published_track, recording_from_gimo
from prbench.recording import PublishedTrack, Recording

__all__ = ["READER", "GimoOptions", "GimoReader", "find_segments", "read_readings"]


@dataclass(frozen=True)
class GimoReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "gimo"
    options: GimoOptions = GimoOptions()  # noqa: RUF009 (frozen)
    extents = staticmethod(extents)
    annotation_columns = gimo.CANDIDATE_COLUMNS

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`find_segments`."""
        return find_segments(root, self.options)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """Read one segment; also one that a build leaves out because no event is known."""
        return self._read(found)[1]

    @property
    def native_joints(self) -> str:
        """See :class:`prbench.readers.PublishedForPrediction`; the jaw needs a body model (option smplx_model)."""
        return gimo.GIMO23 if self.options.route == "smplx" else "smpl22"

    @foreign_input()
    def read_published(self, found: RecordingFiles, *, native: bool) -> tuple[Recording, tuple[PublishedTrack, ...]]:
        """See :class:`prbench.readers.PublishedForPrediction`."""
        readings, recording = self._read(found)
        has_jaw = native and self.native_joints == gimo.GIMO23
        return recording, (published_track(readings, recording, load_manifest("gimo"), with_jaw=has_jaw),)

    def _read(self, found: RecordingFiles) -> tuple[gimo.GimoReadings, Recording]:
        manifest = load_manifest("gimo")
        found.require_usable(manifest.why_bad(found.recording_id))
        readings = read_readings(found, self.options)
        return readings, recording_from_gimo(readings, manifest, dataset=found.dataset)

    def require_further(self, found: RecordingFiles) -> None:
        """See :class:`prbench.readers.NamesFurtherFiles`."""
        open_route(found, self.options)

    def annotation_line(self, found: RecordingFiles) -> AnnotationLine:
        """See :class:`prbench.readers.AnnotatedByHand`."""
        segment = row_of(found)[0].segment
        cells = {"scene": segment.scene, "sequence_path": segment.sequence, "start_frame": segment.start_frame}
        cells |= {"end_frame": segment.end_frame, "activity": segment.activity, gimo.CONFIRMED_COLUMN: ""}
        hint = None if segment.hint is None else segment.hint / gimo.FRAME_RATE
        return AnnotationLine(segment.name, cells, gimo.FRAME_RATE, hint)


READER = GimoReader()
