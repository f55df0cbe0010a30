"""Reader of HOT3D's Aria recordings (docs/specification/hot3d.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.readers.egoallo.bodies import body_model
from prbench.readers.egoallo.files import aria_inputs
from prbench.readers.found import RecordingFiles
from prbench.readers.hot3d.files import Hot3dOptions, extents, find_recordings, read_readings
from prbench.readers.hot3d.to_recording import recording_from_hot3d
from prbench.readers.three_point import attached
from prbench.recording import Recording

__all__ = ["READER", "Hot3dOptions", "Hot3dReader", "find_recordings", "read_readings"]


@dataclass(frozen=True)
class Hot3dReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "hot3d"
    options: Hot3dOptions = Hot3dOptions()  # noqa: RUF009 (frozen)
    egoallo_inputs = staticmethod(aria_inputs)
    require_further = staticmethod(body_model)
    extents = staticmethod(extents)

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`find_recordings`."""
        return find_recordings(root, self.options)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """See :class:`prbench.readers.Reader`."""
        manifest = load_manifest("hot3d")
        found.require_usable(manifest.why_bad(found.recording_id) or found.skip_reason)
        read = recording_from_hot3d(read_readings(found), manifest, dataset=found.dataset, meshes=self.options.meshes)
        return attached(read, found) if self.options.poses == "three-point" else read


READER = Hot3dReader()
