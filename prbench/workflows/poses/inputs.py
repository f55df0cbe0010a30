"""Find what a recording offers to EgoAllo: trajectory, points, wrists, and the VRS recording with the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from prbench.errors import InputFileError
from prbench.readers import RecordingFiles
from prbench.readers.adt import format as adt
from prbench.readers.aria_mps import format as mps
from prbench.readers.found import InputFile
from prbench.readers.zipped import Source, ZippedFile, archive_members, source_of
from prbench.workflows.poses.config import Need

POINT_FILES = ("semidense_points.csv.gz", "global_points.csv.gz")
VRS_NAMES = ("video.vrs", "recording.vrs")
"""Names that ADT and HOT3D give the recording itself; other VRS files beside it are renderings."""
ADT = "adt"


@dataclass(frozen=True)
class Inputs:
    """Files of one recording that EgoAllo reads."""

    found: RecordingFiles
    trajectory: Source
    calibration: Source | None
    """Tells the size of the glasses."""
    points: Source | None
    wrists: Source | None
    vrs: Path | None
    y_up: bool
    """True if trajectory and points must be turned first (ADT)."""

    def lacking(self, needs: frozenset[Need]) -> str:
        """Say in a sentence what EgoAllo needs and the recording lacks; empty if nothing."""
        missing = []
        if "vrs" in needs and self.vrs is None:
            missing.append("the VRS recording, from which it takes the calibration")
        if "points" in needs and self.points is None and not self.y_up:
            missing.append(f"{POINT_FILES[0]} beside the trajectory, from which it takes the floor")
        return f"EgoAllo needs {' and '.join(missing)}" if missing else ""


def find_inputs(root: Path, found: RecordingFiles) -> Inputs:
    """Look for the inputs of one recording.

    Raises:
        InputFileError: if it has no trajectory, or an archive is damaged.
    """
    files = {file.role: file for file in found.files}
    y_up = found.dataset.endswith(ADT)
    trajectory = files.get(mps.TRAJECTORY)
    if trajectory is None:
        name = adt.TRAJECTORY_FILE if y_up else mps.TRAJECTORY_FILE
        raise InputFileError(
            found.folder / name,
            "",
            expected=f"the trajectory of {found.recording_id}",
            found="no such file",
            remedy="Download the recording's SLAM files; without them no body can be estimated.",
        )
    return Inputs(
        found=found,
        trajectory=source_of(trajectory),
        calibration=_source(files.get(mps.CALIBRATION)),
        points=find_points(found),
        wrists=_source(files.get(mps.WRISTS)),
        vrs=_find_vrs(root, found),
        y_up=y_up,
    )


def find_points(found: RecordingFiles) -> Source | None:
    """The semi-dense point cloud of a recording; None where there is none, or the dataset has no such files."""
    if found.dataset.endswith(ADT):
        return _adt_points(found.folder)
    trajectory = next((file for file in found.files if file.role == mps.TRAJECTORY), None)
    return None if trajectory is None else _points_beside(trajectory)


def _source(file: InputFile | None) -> Source | None:
    return None if file is None else source_of(file)


def _points_beside(trajectory: InputFile) -> Source | None:
    if not trajectory.member:
        return next((place for name in POINT_FILES if (place := trajectory.path.with_name(name)).is_file()), None)
    members, folder = archive_members(trajectory.path), PurePosixPath(trajectory.member).parent
    names = (str(folder / name) for name in POINT_FILES)
    return next((ZippedFile(trajectory.path, name) for name in names if name in members), None)


def _adt_points(folder: Path) -> Path | None:
    places = (folder / adt.MPS_FOLDER / place / name for place in ("slam", "trajectory") for name in POINT_FILES)
    return next((place for place in places if place.is_file()), None)


def _find_vrs(root: Path, found: RecordingFiles) -> Path | None:
    """The recording's own VRS file: beside its files, or (HD-EPIC) by name below a folder ``VRS``."""
    for name in (*VRS_NAMES, f"{found.recording_id}.vrs"):
        if (found.folder / name).is_file():
            return found.folder / name
    places = [path for base in ("VRS", "*/VRS") for path in root.glob(f"{base}/**/{found.recording_id}*.vrs")]
    return next((path for path in sorted(places) if path.is_file()), None)
