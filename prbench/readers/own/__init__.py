"""Reader of plain recordings, the form into which anybody's own recordings are brought (docs/own-recordings.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import Manifest, load_manifest, read_own_manifest
from prbench.readers import ReaderOptions
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.found import RecordingFiles
from prbench.readers.own.files import find_recordings, read_readings
from prbench.readers.own.to_recording import recording_from_tables
from prbench.readers.three_point import attached
from prbench.recording import Recording


class OwnOptions(ReaderOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of the reader of plain recordings.

    Attributes:
        manifest: A manifest of one's own: name, licence, thresholds.
        poses: Source of bodies: the table ``body``, or the files of `prbench poses three-point`.
    """

    manifest: Path | None = None
    poses: Literal["table", "three-point"] = "table"


@dataclass(frozen=True)
class OwnReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "own"
    options: OwnOptions = OwnOptions()  # noqa: RUF009 (frozen)

    @property
    def manifest(self) -> Manifest:
        """Return the user's manifest, or prbench's."""
        file = self.options.manifest
        return load_manifest(self.dataset) if file is None else read_own_manifest(file.expanduser())

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`prbench.readers.own.files.find_recordings`."""
        return find_recordings(root, self.manifest.name)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """See :class:`prbench.readers.Reader`."""
        read = recording_from_tables(read_readings(found), self.manifest, found)
        return attached(read, found) if self.options.poses == "three-point" else read

    def extents(self, found: RecordingFiles, recording: Recording | None) -> tuple[Extent, ...]:  # noqa: ARG002
        """See :class:`prbench.readers.KnowsEnds`; objects and hands may be out of sight."""
        lasting = {} if recording is None else {name: getattr(recording, name) for name in ("head", "gaze", "body")}
        ends = {name: stream.times[[0, -1]] for name, stream in lasting.items() if stream and len(stream.times)}
        return tuple(
            Extent(name, "its table", float(first), float(last), may_start_late=True, slack=SEVERAL_SENSORS)
            for name, (first, last) in ends.items()
        )


READER = OwnReader()
