"""Find a recording's inputs for EgoAllo: trajectory, points, wrists, and the VRS recording with the calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from prbench.errors import InputFileError
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.format import AriaTrajectory, GlassesSize
from prbench.readers.found import InputFile, RecordingFiles
from prbench.readers.zipped import Source, ZippedFile, archive_members, source_of

POINT_FILES = ("semidense_points.csv.gz", "global_points.csv.gz")
Need = Literal["vrs", "points"]
"""Inputs that EgoAllo may need besides the trajectory."""
_VRS_NAMES = ("video.vrs", "recording.vrs")  # what datasets call the recording itself; others beside it are renderings


@dataclass(frozen=True)
class EgoalloInputs:
    """Files of one recording that EgoAllo reads."""

    found: RecordingFiles
    trajectory: Source
    calibration: Source | None
    """Tells the size of the glasses."""
    points: Source | None
    wrists: Source | None
    vrs: Path | None
    glasses_size: GlassesSize
    """Size of the glasses where no calibration tells it."""
    turned: Callable[[AriaTrajectory], AriaTrajectory] | None = None
    """Brings the poses of a world with Y up into EgoAllo's world and rate; points must be turned, too. None where both
    can be given as they are."""

    def lacking(self, needs: frozenset[Need]) -> str:
        """Name the missing inputs in a sentence; empty if nothing is missing."""
        missing = []
        if "vrs" in needs and self.vrs is None:
            missing.append("the VRS recording, from which it takes the calibration")
        if "points" in needs and self.points is None and self.turned is None:
            missing.append(f"{POINT_FILES[0]} beside the trajectory, from which it takes the floor")
        return f"EgoAllo needs {' and '.join(missing)}" if missing else ""


class GlassesWithMps:
    """A reader of recordings with files of the Machine Perception Services (:class:`prbench.readers.AriaGlasses`)."""

    def egoallo_inputs(self, root: Path, found: RecordingFiles) -> EgoalloInputs:
        """See :class:`prbench.readers.AriaGlasses`."""
        return aria_inputs(root, found)

    def point_cloud(self, found: RecordingFiles) -> Source | None:
        """See :class:`prbench.readers.AriaGlasses`."""
        return points_beside(found)


def aria_inputs(root: Path, found: RecordingFiles) -> EgoalloInputs:
    """Look for the inputs of a recording that has files of the Machine Perception Services.

    Raises:
        InputFileError: if it has no trajectory, or an archive is damaged.
    """
    trajectory = require_trajectory(found, mps.TRAJECTORY_FILE)
    return EgoalloInputs(
        found=found,
        trajectory=source_of(trajectory),
        calibration=_source(found, mps.CALIBRATION),
        points=points_beside(found),
        wrists=_source(found, mps.WRISTS),
        vrs=_find_vrs(root, found),
        glasses_size="DVT-S",
    )


def require_trajectory(found: RecordingFiles, name: str) -> InputFile:
    """The trajectory of the glasses.

    Raises:
        InputFileError: if there is none; ``name`` tells the user what was looked for.
    """
    trajectory = next((file for file in found.files if file.role == mps.TRAJECTORY), None)
    if trajectory is None:
        raise InputFileError(
            found.folder / name,
            "",
            expected=f"the trajectory of {found.recording_id}",
            found="no such file",
            remedy="Download the recording's SLAM files; without them no body can be estimated.",
        )
    return trajectory


def points_beside(found: RecordingFiles) -> Source | None:
    """The semi-dense point cloud beside the trajectory, in the same folder or archive; None where there is none."""
    trajectory = next((file for file in found.files if file.role == mps.TRAJECTORY), None)
    if trajectory is None:
        return None
    if not trajectory.member:
        return next((place for name in POINT_FILES if (place := trajectory.path.with_name(name)).is_file()), None)
    members = archive_members(trajectory.path)
    folder = PurePosixPath(trajectory.member).parent
    names = (str(folder / name) for name in POINT_FILES)
    return next((ZippedFile(trajectory.path, name) for name in names if name in members), None)


def _find_vrs(root: Path, found: RecordingFiles) -> Path | None:
    """The recording's own VRS file: beside its files, or by its name below a folder ``VRS``."""
    for name in (*_VRS_NAMES, f"{found.recording_id}.vrs"):
        if (found.folder / name).is_file():
            return found.folder / name
    places = [path for base in ("VRS", "*/VRS") for path in root.glob(f"{base}/**/{found.recording_id}*.vrs")]
    return next((path for path in sorted(places) if path.is_file()), None)


def _source(found: RecordingFiles, role: str) -> Source | None:
    return next((source_of(file) for file in found.files if file.role == role), None)
