"""Which recordings lack a body, and one recording as EgoAllo wants to see it: one folder, plain files, Z up, 1 kHz."""

from __future__ import annotations

import gzip
import math
import os
import shutil
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv

from prbench.errors import InputFileError, PrbenchError, UsageError
from prbench.files.bounded import copy_file, require
from prbench.files.storage import atomic_path
from prbench.geometry.timelines import nearest_index
from prbench.limits import LARGEST_FILE
from prbench.protocol.manifests import load_manifest
from prbench.readers import AriaGlasses, RecordingFiles, reader_for
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import read_size_and_camera, read_trajectory
from prbench.readers.aria_mps.format import AriaTrajectory
from prbench.readers.aria_mps.to_recording import part_poses
from prbench.readers.discover import discover, usable_readers
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import read_own_output
from prbench.readers.egoallo.files import OUTPUT_ROLE, POINT_FILES, EgoalloInputs, poses_folder
from prbench.readers.files import Source, opened, write_table
from prbench.recording import PoseStream

_FPS = 30.0
_POINT_COLUMNS = ("uid", "graph_uid", "px_world", "py_world", "pz_world", "inv_dist_std", "dist_std")
_GRAVITY = 9.81
_FLOOR_POINTS = 40  # a grid of so many by so many points over so many metres
_FLOOR_EDGE = 4.0
_SURE = (1e-6, 1e-4)  # inv_dist_std, dist_std: below the strictest limits


def prepare(inputs: EgoalloInputs, folder: Path) -> tuple[Path, int]:
    """Write a recording's inputs into a folder; large files are linked, not copied, where that is possible.

    Args:
        inputs: What the dataset has of the recording.
        folder: A folder for EgoAllo's ``--traj-root``.

    Returns:
        The trajectory file in it, and the number of output frames that cover the whole recording.

    Raises:
        InputFileError: for a damaged input, or a trajectory too short or too slow for EgoAllo.
        StorageError: if the folder cannot be written.
    """
    trajectory = source_trajectory(inputs)
    place = folder / mps.SLAM_FOLDER / mps.TRAJECTORY_FILE
    # A trajectory is written anew only where it has to change: turned to Z up, or without poses that are no poses.
    # Everything else keeps the bytes of the dataset.
    if inputs.turned is not None or trajectory.left_out:
        still = np.zeros((len(trajectory.time_us), 6))
        columns = mps.trajectory_columns(trajectory, trajectory.graph_uids[0], -_GRAVITY * trajectory.up, still)
        with atomic_path(place) as temporary, open(temporary, "wb") as file:
            write_table(file, pa.table(columns))
    else:
        _bring(inputs.trajectory, place)
    points = folder / mps.SLAM_FOLDER / POINT_FILES[0]
    if inputs.turned is not None:
        _write_turned_points(inputs.points, points)
    elif inputs.points is not None:
        _bring(inputs.points, points)
    if inputs.wrists is not None:
        _bring(inputs.wrists, folder / mps.HAND_FOLDER / mps.WRISTS_FILE)
    if inputs.vrs is not None:
        _bring(inputs.vrs, folder / inputs.vrs.name)
    # Frames of an output for the whole recording: EgoAllo's own sampling, less the first pose.
    n = len(trajectory.time_us)
    seconds = float(trajectory.time_us[-1] - trajectory.time_us[0]) / 1e6
    # As EgoAllo's own script does it, rounding included: it takes every int(rate / 30)-th pose, and its outputs have
    # one frame less than it takes poses.
    step = int(n / seconds // _FPS) if seconds > 0 else 0
    frames = math.ceil(n / step) - 1 if step else 0
    expected = f"a trajectory of more than {_FPS:.0f} poses a second and of at least two output frames"
    remedy = "EgoAllo takes every int(rate / 30)-th pose and would take none."
    require(inputs.found.folder, (frames >= 1, "trajectory", expected, f"{n} poses in {seconds:.3f} s", remedy))
    return place, frames


def source_trajectory(inputs: EgoalloInputs) -> AriaTrajectory:
    """Return the poses that EgoAllo is given: the recording's own, or (in a world with Y up) turned and at 1 kHz.

    Raises:
        InputFileError: if the trajectory is damaged.
    """
    trajectory = read_trajectory(inputs.trajectory)
    return trajectory if inputs.turned is None else inputs.turned(trajectory)


def head_poses(inputs: EgoalloInputs, trajectory: AriaTrajectory) -> PoseStream:
    """Central pupil frame in the world of EgoAllo's outputs, device seconds."""
    size = read_size_and_camera(inputs.calibration)[0] or inputs.glasses_size
    valid = np.ones(len(trajectory.time_us), dtype=bool)
    device = PoseStream(trajectory.time_us / 1e6, trajectory.position, trajectory.rotation, valid)
    return part_poses(device, mps.device_from_cpf(size))


def _bring(source: Source, place: Path) -> None:
    """Make a file appear in the folder: a link to a plain one, the unpacked member of an archive."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if not isinstance(source, Path):
        with atomic_path(place) as temporary, opened(source) as packed, open(temporary, "wb") as plain:
            shutil.copyfileobj(packed, plain)
        return
    # VRS files have gigabytes. Windows may refuse symbolic links, other disks refuse hard ones; a copy always works.
    for link in (os.symlink, os.link):
        try:
            link(source.absolute(), place)
        except OSError:
            continue
        return
    copy_file(source, place)


def _write_turned_points(source: Source | None, place: Path) -> None:
    """Points of a world with Y up, with Z up; without any, a flat floor at height 0, where such scenes have it."""
    if source is None:
        x, y = np.meshgrid(*2 * [np.linspace(-_FLOOR_EDGE, _FLOOR_EDGE, _FLOOR_POINTS)])
        points = (x.ravel(), y.ravel(), np.zeros(x.size))
        values = (np.arange(x.size), np.full(x.size, "floor"), *points, *(np.full(x.size, sure) for sure in _SURE))
        table = pa.table(dict(zip(_POINT_COLUMNS, values, strict=True)))
    else:
        with opened(source) as packed, gzip.open(packed, "rb") as plain:
            content = plain.read(LARGEST_FILE + 1)
        is_harmless = len(content) <= LARGEST_FILE
        require(str(source), (is_harmless, "", f"at most {LARGEST_FILE:,} bytes unpacked", "more", ""))
        try:
            table = pyarrow.csv.read_csv(pa.BufferReader(content))
            x, y, z = (table[name] for name in _POINT_COLUMNS[2:5])
        except (pa.ArrowInvalid, KeyError) as error:
            expected = "points with px_world, py_world, pz_world"
            raise InputFileError(str(source), "", expected=expected, found=str(error).splitlines()[0]) from error
        # (x, y, z) with Y up is (x, -z, y) with Z up.
        for name, values in zip(_POINT_COLUMNS[2:5], (x, pa.array(-z.to_numpy()), y), strict=True):
            table = table.set_column(table.column_names.index(name), name, values)
    # Without name and time, equal points are equal files.
    with (
        atomic_path(place) as temporary,
        open(temporary, "wb") as packed,
        gzip.GzipFile("", "wb", compresslevel=1, fileobj=packed, mtime=0) as file,
    ):
        write_table(file, table)


_STEP = 0.033  # seconds between the instants that are asked about
_MISSING_ALLOWED = 0.5  # seconds, share of a short recording: first frame, last part of a window
_MISSING_SHARE = 0.1


@dataclass(frozen=True)
class PoseState:
    """One recording and what there is of its body.

    Attributes:
        found: The recording.
        state: Outputs that are whole (``complete``), cover a part, or are of another recording or damaged; none; no
            trajectory to make any from; or a recording that is known to be bad.
        message: Details for the user.
        target: The folder in which readers look for outputs.
        inputs: The inputs; None where there is no trajectory to start from.
    """

    found: RecordingFiles
    state: Literal["complete", "partial", "refused", "missing", "unreadable", "skipped"]
    message: str
    target: Path
    inputs: EgoalloInputs | None

    @property
    def lacking(self) -> bool:
        """Return True if a body is still to be made."""
        return self.state not in ("complete", "skipped")


def pose_states(
    root: Path,
    dataset: str | None = None,
    *,
    recordings: str = "*",
    limit: int | None = None,
    poses_root: Path | None = None,
) -> Iterator[PoseState]:
    """Look at the recordings below a folder, one by one.

    Args:
        root: The dataset's folder.
        dataset: A dataset of Aria glasses; found out from the folder if None.
        recordings: Pattern of names.
        limit: Largest number of recordings.
        poses_root: Folder of outputs by recording; ``root/egoallo`` if None.

    Raises:
        InputFileError: if there are none.
        UsageError: for a dataset that is none of Aria glasses, or a folder of several.
    """
    root = root.expanduser().resolve()
    datasets = tuple(reader.dataset for reader in usable_readers()[0] if isinstance(reader, AriaGlasses))
    dataset = dataset or held_dataset(root, datasets)
    if dataset not in datasets:
        raise UsageError(f"EgoAllo needs Aria glasses: --dataset must be {', '.join(datasets)}, not '{dataset}'.")
    options = {"poses": "egoallo"} | ({} if poses_root is None else {"poses_root": str(poses_root)})
    found = reader_for(dataset, options).find(root)
    chosen = [each for each in found if fnmatchcase(each.recording_id, recordings)]
    if not chosen:
        raise UsageError(f"no recording matches '{recordings}'; there are {len(found)} others.")
    for each in chosen[:limit]:
        yield _pose_state(root, each, poses_root)


def held_dataset(root: Path, datasets: Collection[str]) -> str:
    """Return the one of some datasets that a folder holds.

    Raises:
        UsageError: if there are none or several.
    """
    try:
        held = sorted({each.dataset for each in discover(root).found if each.root == root} & set(datasets))
    except PrbenchError as error:
        raise UsageError(f"{error} Name the dataset with --dataset.") from error
    if len(held) != 1:
        names = " and ".join(held) or f"none of {', '.join(datasets)}"
        raise UsageError(f"{root} holds {names}; give the folder of one dataset, or name it with --dataset.")
    return held[0]


def _pose_state(root: Path, found: RecordingFiles, poses_root: Path | None) -> PoseState:
    """Look at one recording's outputs and inputs."""
    outputs = [file.path for file in found.files if file.role.startswith(OUTPUT_ROLE)]
    target = outputs[0].parent if outputs else poses_folder(root, found.recording_id, poses_root)
    # Synthetic recordings imitate a dataset and share its manifest.
    manifest = load_manifest(found.dataset)
    # Making a body for a recording that every build skips would waste GPU hours.
    if bad := found.skip_reason or manifest.why_bad(found.recording_id):
        return PoseState(found, "skipped", bad, target, None)
    try:
        reader = reader_for(found.dataset)
        assert isinstance(reader, AriaGlasses), "pose_states() takes recordings of such datasets alone"
        inputs = reader.egoallo_inputs(root, found)
        if not outputs:
            return PoseState(found, "missing", "no outputs", target, inputs)
        cpf = head_poses(inputs, source_trajectory(inputs))
    except InputFileError as error:
        return PoseState(found, "unreadable", str(error), target, None)
    try:
        complete, covered = coverage(outputs, cpf)
    except InputFileError as error:
        return PoseState(found, "refused", str(error), target, inputs)
    message = f"{len(outputs)} outputs cover {covered}"
    return PoseState(found, "complete" if complete else "partial", message, target, inputs)


def coverage(outputs: Sequence[Path], cpf: PoseStream) -> tuple[bool, str]:
    """Check some outputs and say how much of the recording they cover.

    Args:
        outputs: Files of one recording.
        cpf: The recording's central pupil frame in the world of the outputs, device seconds.

    Returns:
        True if nothing but the ends of windows is missing, and the covered time in words.

    Raises:
        InputFileError: for the first output that is damaged or belongs to another recording.
    """
    found = np.unique(np.concatenate([read_own_output(path, cpf).time_ns for path in outputs])) / 1e9
    seconds = float(cpf.times[-1] - cpf.times[0])
    # Asked at a regular step, so that a dense part of the trajectory weighs no more than a sparse one. Instants
    # without a head pose count for nobody: EgoAllo cannot fill them.
    regular = cpf.times[0] + np.arange(int(seconds / _STEP) + 1) * _STEP
    posed = np.abs(cpf.times[nearest_index(cpf.times, regular)] - regular) <= ego.LONGEST_STEP / 2
    asked = regular[posed]
    lacking = asked
    if len(found):
        lacking = asked[np.abs(found[nearest_index(found, asked)] - asked) > ego.LONGEST_STEP]
    missing = len(lacking) * _STEP
    complete = missing <= min(_MISSING_ALLOWED, _MISSING_SHARE * seconds) + 1e-9
    if not len(lacking):
        return complete, f"all {seconds:.1f} s"
    first = lacking[0] - cpf.times[0]
    return complete, f"{seconds - missing:.1f} of {seconds:.1f} s, missing first at {first:.1f} s from the start"
