"""Reader of Aria Digital Twin, layout v2.0 (docs/specification/adt.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from prbench.files.bounded import foreign_input
from prbench.protocol.manifests import load_manifest
from prbench.readers.adt import format as adt
from prbench.readers.adt.files import AdtOptions, associated_people, extents, find_recordings, read_readings
from prbench.readers.adt.to_recording import ASSUMED_SIZE, prepared_trajectory, recording_from_adt
from prbench.readers.egoallo.bodies import body_model
from prbench.readers.egoallo.files import POINT_FILES, EgoalloInputs, aria_inputs
from prbench.readers.found import RecordingFiles
from prbench.readers.three_point import attached
from prbench.recording import Recording

__all__ = ["READER", "AdtOptions", "AdtReader", "find_recordings", "read_readings", "read_recording"]


_DEFAULTS = AdtOptions()


@foreign_input()
def read_recording(found: RecordingFiles, options: AdtOptions = _DEFAULTS) -> Recording:
    """Read one recording (see :class:`prbench.readers.Reader` for what it raises)."""
    manifest = load_manifest("adt")
    found.require_usable(manifest.why_bad(found.recording_id))
    read = recording_from_adt(read_readings(found, options), manifest, dataset=found.dataset, poses=options.poses)
    return attached(read, found) if options.poses == "three-point" else read


@dataclass(frozen=True)
class AdtReader:
    """See :class:`prbench.readers.Reader`."""

    dataset: str = "adt"
    options: AdtOptions = _DEFAULTS
    extents = staticmethod(extents)

    @foreign_input()
    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        """See :func:`find_recordings`."""
        return find_recordings(root, self.options)

    @foreign_input()
    def read(self, found: RecordingFiles) -> Recording:
        """See :func:`read_recording`."""
        return read_recording(found, self.options)

    @foreign_input()
    def require_further(self, found: RecordingFiles) -> None:
        """See :class:`prbench.readers.NamesFurtherFiles`."""
        associated_people(found)
        body_model(found)

    def egoallo_inputs(self, root: Path, found: RecordingFiles) -> EgoalloInputs:
        """See :class:`prbench.readers.AriaGlasses`."""
        # The semi-dense point cloud of the Machine Perception Services.
        folder = found.folder / adt.MPS_FOLDER
        clouds = (folder / place / name for place in ("slam", "trajectory") for name in POINT_FILES)
        inputs = aria_inputs(root, found, adt.TRAJECTORY_FILE)
        points = next((path for path in clouds if path.is_file()), None)
        return replace(inputs, points=points, glasses_size=ASSUMED_SIZE, turned=prepared_trajectory)


READER = AdtReader()
