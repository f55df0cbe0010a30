"""Find the inputs of EgoAllo, its outputs and its body model (docs/specification/egoallo.md#files)."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import require
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.format import AriaTrajectory, GlassesSize
from prbench.readers.egoallo import format as ego
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.files import Source, archive_members, source_of
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present

OUTPUT_ROLE = "egoallo/"  # Roles of output files are this and the file's name.
MODEL_ROLE = "smplh_model"
_MODEL_VARIABLE = "PRBENCH_SMPLH_MODEL"


def poses_folder(root: Path, recording_id: str, poses_root: Path | None = None) -> Path:
    """Return the folder of a recording's outputs: below ``poses_root``, else ``root/egoallo``."""
    base = root / ego.POSES_FOLDER if poses_root is None else poses_root.expanduser()
    return base / recording_id / ego.OUTPUT_FOLDER


def find_outputs(
    root: Path, folder: Path | None, name: str, poses_root: Path | None = None, *, smplh_model: Path | None = None
) -> tuple[InputFile, ...]:
    """Find the output files of one recording, and the body model; nothing where there are no outputs.

    Of several places the first with outputs counts: the recording's folder in ``poses_root`` if that is given, the
    recording's own folder, the recording's folder in ``root/egoallo``.

    Args:
        root: The dataset's folder.
        folder: The recording's own folder; None where it has none (archives).
        name: Name of the recording.
        poses_root: Folder in which the user keeps poses.
        smplh_model: The body model; the environment's or the one below ``root`` by default.

    Returns:
        Files with the roles ``egoallo/<file name>`` and ``smplh_model``.
    """
    places = [] if poses_root is None else [poses_folder(root, name, poses_root)]
    places += [] if folder is None else [folder / ego.OUTPUT_FOLDER]
    for place in (*places, poses_folder(root, name)):
        if outputs := sorted(path for path in place.glob("*.npz") if not path.name.startswith(".")):
            files = [input_file(f"{OUTPUT_ROLE}{path.name}", path) for path in outputs]
            model = find_model(root, smplh_model)
            if model is not None and is_present(model):
                files.append(input_file(MODEL_ROLE, model))
            return tuple(files)
    return ()


def find_model(root: Path, smplh_model: Path | None = None) -> Path | None:
    """Find the body model: the given one, that of ``PRBENCH_SMPLH_MODEL``, or ``root/smplh/neutral/model.npz``.

    Returns:
        A path that the user named, whether it exists or not; of the place below ``root`` only an existing file.
    """
    named = smplh_model or (Path(os.environ[_MODEL_VARIABLE]) if os.environ.get(_MODEL_VARIABLE) else None)
    if named is not None:
        return named.expanduser()
    beside = root / ego.MODEL_FILE
    return beside if is_present(beside) else None


def body_extent(found: RecordingFiles) -> tuple[Extent, ...]:
    """Return the extent of all outputs of a recording, on the device clock; nothing without readable outputs."""
    times = {}
    for path in (file.path for file in found.files if file.role.startswith(OUTPUT_ROLE)):
        with contextlib.suppress(InputFileError):  # a damaged one is told by whoever reads it
            known = Archive(path).load([ego.TIMES]).get(ego.TIMES)
            if known is not None and known.size:
                times[path] = float(known.min()), float(known.max())
    if not times:
        return ()
    latest = max(times, key=lambda path: times[path][1])
    first = min(begin for begin, _ in times.values())
    last = times[latest][1]
    return (Extent("body by EgoAllo", latest.name, first / 1e9, last / 1e9, tells_span=False, slack=SEVERAL_SENSORS),)


POINT_FILES = ("semidense_points.csv.gz", "global_points.csv.gz")
Need = Literal["vrs", "points"]  # Inputs that EgoAllo may need besides the trajectory.
_VRS_NAMES = ("video.vrs", "recording.vrs")  # what datasets call the recording itself; others beside it are renderings


@dataclass(frozen=True)
class EgoalloInputs:
    """Files of one recording that EgoAllo reads.

    Attributes:
        calibration: Tells the size of the glasses.
        glasses_size: Size of the glasses where no calibration tells it.
        turned: Brings the poses of a world with Y up into EgoAllo's world and rate; points must be turned, too. None
            where both can be given as they are.
    """

    found: RecordingFiles
    trajectory: Source
    calibration: Source | None
    points: Source | None
    wrists: Source | None
    vrs: Path | None
    glasses_size: GlassesSize
    turned: Callable[[AriaTrajectory], AriaTrajectory] | None = None

    def lacking(self, needs: frozenset[Need]) -> str:
        """Name the missing inputs in a sentence; empty if nothing is missing."""
        missing = []
        if "vrs" in needs and self.vrs is None:
            missing.append("the VRS recording, from which it takes the calibration")
        if "points" in needs and self.points is None and self.turned is None:
            missing.append(f"{POINT_FILES[0]} beside the trajectory, from which it takes the floor")
        return f"EgoAllo needs {' and '.join(missing)}" if missing else ""


def aria_inputs(root: Path, found: RecordingFiles, name: str = mps.TRAJECTORY_FILE) -> EgoalloInputs:
    """Look for the inputs of a recording that has files of the Machine Perception Services.

    Args:
        root: The dataset's folder.
        found: The recording.
        name: Name of its trajectory file, for the message.

    Raises:
        InputFileError: if it has no trajectory, or an archive is damaged.
    """
    sources = {file.role: source_of(file) for file in found.files}
    expected = f"the trajectory of {found.recording_id}"
    remedy = "Download the recording's SLAM files; without them no body can be estimated."
    require(found.folder / name, (mps.TRAJECTORY in sources, "", expected, "no such file", remedy))
    # The recording's own VRS file: beside its files, or by its name below a folder VRS.
    places = [found.folder / vrs for vrs in (*_VRS_NAMES, f"{found.recording_id}.vrs")]
    below = (path for base in ("VRS", "*/VRS") for path in root.glob(f"{base}/**/{found.recording_id}*.vrs"))
    vrs = next((path for path in (*places, *sorted(below)) if path.is_file()), None)
    slam = (sources[mps.TRAJECTORY], sources.get(mps.CALIBRATION), points_beside(found))
    return EgoalloInputs(found, *slam, sources.get(mps.WRISTS), vrs, "DVT-S")


def points_beside(found: RecordingFiles) -> Source | None:
    """Return the semi-dense point cloud beside the trajectory, in the same folder or archive, or None."""
    trajectory = next((file for file in found.files if file.role == mps.TRAJECTORY), None)
    if trajectory is None:
        return None
    if not trajectory.member:
        return next((place for name in POINT_FILES if (place := trajectory.path.with_name(name)).is_file()), None)
    members = archive_members(trajectory.path)
    folder = PurePosixPath(trajectory.member).parent
    names = (str(folder / name) for name in POINT_FILES)
    clouds = (InputFile("points", trajectory.path, members[name], name) for name in names if name in members)
    return next(clouds, None)
