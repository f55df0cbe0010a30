"""Find the inputs of EgoAllo, its outputs and its body model; read one output.

Sources: docs/specification/egoallo.md#files and docs/specification/egoallo.md#bad-input.
"""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np

from prbench.errors import InputFileError
from prbench.files.arrays import Archive
from prbench.files.bounded import foreign_input, read_whole
from prbench.limits import LARGEST_UNPACKED_FOR_ITS_END
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.format import AriaTrajectory, GlassesSize
from prbench.readers.egoallo import format as ego
from prbench.readers.extents import SEVERAL_SENSORS, Extent
from prbench.readers.files import Source, ZippedFile, archive_members, require_increasing, source_of
from prbench.readers.found import InputFile, RecordingFiles, input_file, is_present

OUTPUT_ROLE = "egoallo/"
"""Roles of output files are this and the file's name."""
_OPTIONS_ROLE = "egoallo options/"
"""Roles of the options beside them, likewise."""
MODEL_ROLE = "smplh_model"
_MODEL_VARIABLE = "PRBENCH_SMPLH_MODEL"


def poses_folder(root: Path, recording_id: str, poses_root: Path | None = None) -> Path:
    """Return the folder of a recording's outputs: below ``poses_root``, else ``root/egoallo``."""
    base = root / ego.POSES_FOLDER if poses_root is None else poses_root.expanduser()
    return base / recording_id / ego.OUTPUT_FOLDER


def find_outputs(
    root: Path,
    folder: Path | None,
    recording_id: str,
    poses_root: Path | None = None,
    *,
    smplh_model: Path | None = None,
) -> tuple[InputFile, ...]:
    """Output files of one recording, and the body model where there is one; nothing where there are no outputs.

    Of several places the first with outputs counts: the recording's folder in ``poses_root`` if that is given, the
    recording's own folder, the recording's folder in ``root/egoallo``.

    Args:
        root: The dataset's folder.
        folder: The recording's own folder; None where it has none (archives).
        recording_id: Name of the recording.
        poses_root: Where the user keeps poses.
        smplh_model: The body model; the environment's or the one below ``root`` by default.

    Returns:
        Files with the roles ``egoallo/<file name>``, ``egoallo options/<file name>`` and ``smplh_model``.
    """
    places = [poses_folder(root, recording_id, poses_root)] if poses_root is not None else []
    places += [folder / ego.OUTPUT_FOLDER] if folder is not None else []
    places.append(poses_folder(root, recording_id))
    for place in places:
        outputs = _outputs(place)
        if outputs:
            model = find_model(root, smplh_model)
            files = [input_file(f"{OUTPUT_ROLE}{path.name}", path) for path in outputs]
            options = [path.with_name(f"{path.stem}{ego.ARGUMENTS_SUFFIX}") for path in outputs]
            files += [input_file(f"{_OPTIONS_ROLE}{path.name}", path) for path in options if is_present(path)]
            return (*files, *([input_file(MODEL_ROLE, model)] if model is not None and is_present(model) else []))
    return ()


def _outputs(folder: Path) -> list[Path]:
    """The output files of a folder; where options outnumber them, the missing ones too, and reading them says so."""
    found = {path for path in folder.glob("*.npz") if not path.name.startswith(".")}
    options = [path for path in folder.glob(f"*{ego.ARGUMENTS_SUFFIX}") if not path.name.startswith(".")]
    if not found or len(options) <= len(found):
        return sorted(found)
    return sorted(found | {path.with_name(f"{path.name.removesuffix(ego.ARGUMENTS_SUFFIX)}.npz") for path in options})


def find_model(root: Path, smplh_model: Path | None = None) -> Path | None:
    """The body model: the given one, else that of ``PRBENCH_SMPLH_MODEL``, else ``root/smplh/neutral/model.npz``.

    Returns:
        A path that the user named, whether it exists or not; of the place below ``root`` only an existing file.
    """
    named = smplh_model or (Path(os.environ[_MODEL_VARIABLE]) if os.environ.get(_MODEL_VARIABLE) else None)
    if named is not None:
        return named.expanduser()
    beside = root / ego.MODEL_FILE
    return beside if is_present(beside) else None


def body_extent(found: RecordingFiles) -> Extent | None:
    """All outputs of a recording together, on the device clock; None without outputs that can be read."""
    times = {file.path: _times_of(file.path) for file in found.files if file.role.startswith(OUTPUT_ROLE)}
    known = [each for each in times.values() if each.size]
    if not known:
        return None
    first = min(float(each.min()) for each in known)
    latest = max((path for path in times if times[path].size), key=lambda path: float(times[path].max()))
    return Extent(
        "body by EgoAllo",
        latest.name,
        first / 1e9,
        float(times[latest].max()) / 1e9,
        tells_span=False,
        slack=SEVERAL_SENSORS,
    )


def _times_of(path: Path) -> np.ndarray:
    """Times of one output, nanoseconds; none of a damaged one, which is told by whoever reads it."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{ego.TIMES}.npy") as member:
            if archive.getinfo(f"{ego.TIMES}.npy").file_size > LARGEST_UNPACKED_FOR_ITS_END:
                return np.zeros(0)
            return np.lib.format.read_array(member, allow_pickle=False)  # type: ignore[arg-type] - any file works
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        return np.zeros(0)


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


_AGAIN = "Delete it and run `prbench poses egoallo` again."
_SHAPES = {
    ego.WORLD_FROM_CPF: ("T", 7),
    ego.WORLD_FROM_ROOT: ("S", "T", 7),
    ego.BODY_QUATS: ("S", "T", ego.N_BODY_QUATS, 4),
    ego.BETAS: ("S", "T", ego.N_BETAS),
}
_QUATERNIONS = {ego.WORLD_FROM_CPF: slice(0, 4), ego.WORLD_FROM_ROOT: slice(0, 4), ego.BODY_QUATS: slice(0, 4)}


@foreign_input()
def read_output(path: Path) -> ego.EgoAlloOutput | ego.BodyWindow:
    """Read one output file.

    Raises:
        InputFileError: if the file is missing or no npz archive of plain arrays, or a key is missing, empty, of another
            shape than the others, or holds NaN, quaternions of another length than 1, or times that do not increase.
    """
    try:
        return parse_output(path, read_whole(path))
    except FileNotFoundError as error:
        raise InputFileError(path, "", expected="an output of EgoAllo", found="no such file", remedy=_AGAIN) from error


@foreign_input()
def parse_output(path: Path, content: bytes) -> ego.EgoAlloOutput | ego.BodyWindow:
    """:func:`read_output` of bytes that are at hand; ``path`` is for the messages."""
    archive = Archive(path, content, remedy=f"The file may be truncated. {_AGAIN}")
    arrays = archive.load((ego.TIMES, ego.JOINTS, *_SHAPES))  # what else it holds is not even unpacked
    times = _present(path, arrays, ego.TIMES)
    if times.ndim != 1 or not np.issubdtype(times.dtype, np.integer):
        found = f"{times.dtype} {times.shape}"
        raise InputFileError(path, ego.TIMES, expected="integers (T,), nanoseconds", found=found, remedy=_AGAIN)
    if len(times) == 0:
        raise InputFileError(path, ego.TIMES, expected="at least one frame", found="T = 0", remedy=_AGAIN)
    require_increasing(path, times, unit="ns", place=f"{ego.TIMES}, frame", first=0, remedy=_AGAIN)
    time_ns = times.astype(np.int64)
    if ego.JOINTS in arrays and ego.WORLD_FROM_ROOT not in arrays:
        joints = _require(path, arrays, ego.JOINTS, (len(time_ns), 22, 3))
        return ego.BodyWindow(path.name, time_ns, joints)  # of another pipeline: joints instead of rotations
    sizes: dict[str, int] = {"T": len(time_ns)}
    checked = {}
    for key, form in _SHAPES.items():
        if key == ego.WORLD_FROM_ROOT and key in arrays and arrays[key].ndim == len(form):
            sizes["S"] = len(arrays[key])
            if sizes["S"] == 0:
                raise InputFileError(path, key, expected="at least one sample", found="S = 0", remedy=_AGAIN)
        shape = tuple(size if isinstance(size, int) else sizes.get(size, -1) for size in form)
        checked[key] = _require(path, arrays, key, shape)
        if key in _QUATERNIONS:
            quaternions = checked[key][..., _QUATERNIONS[key]]
            error = np.abs(np.linalg.norm(quaternions.astype(np.float64), axis=-1) - 1)
            worst = np.unravel_index(int(np.argmax(error)), error.shape)
            if error[worst] > ego.QUATERNION_TOLERANCE:
                length = float(np.linalg.norm(quaternions[worst].astype(np.float64)))
                raise InputFileError(
                    path,
                    f"{key}{[int(index) for index in worst]}",
                    expected="a quaternion of length 1",
                    found=f"length {length:.4f}",
                    remedy=_AGAIN,
                )
    return ego.EgoAlloOutput(
        name=path.name,
        time_ns=time_ns,
        world_from_cpf=checked[ego.WORLD_FROM_CPF],
        world_from_root=checked[ego.WORLD_FROM_ROOT],
        body_quats=checked[ego.BODY_QUATS],
        betas=checked[ego.BETAS],
    )


def _present(path: Path, arrays: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    if key not in arrays:
        raise InputFileError(
            path,
            "",
            expected=f"an array '{key}'",
            found=f"the arrays {', '.join(sorted(arrays)) or 'none that is known'}",
            remedy=f"Outputs of EgoAllo hold it, and joints-only files hold '{ego.JOINTS}' and '{ego.TIMES}'. {_AGAIN}",
        )
    return arrays[key]


def _require(path: Path, arrays: Mapping[str, np.ndarray], key: str, shape: tuple[int, ...]) -> np.ndarray:
    """One array of floats of the expected shape, without NaN."""
    array = _present(path, arrays, key)
    if array.shape != shape or not np.issubdtype(array.dtype, np.floating):
        expected = f"floats of the shape {shape} (as many frames as '{ego.TIMES}' and as many samples everywhere)"
        found = f"{array.dtype} {array.shape}"
        raise InputFileError(path, key, expected=expected, found=found, remedy=_AGAIN)
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        raise InputFileError(
            path,
            f"{key}{bad[0].tolist()}",
            expected="finite numbers",
            found=f"NaN or infinity in {len(bad)} places",
            remedy=_AGAIN,
        )
    return array if array.dtype == np.float64 else array.astype(np.float32)
