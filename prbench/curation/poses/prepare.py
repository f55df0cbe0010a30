"""Write one recording as EgoAllo wants to see it: one folder, plain files, Z up, 1 kHz."""

from __future__ import annotations

import gzip
import math
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.csv

from prbench.errors import InputFileError
from prbench.files.storage import atomic_path
from prbench.limits import LARGEST_FILE
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.files import read_first_calibration
from prbench.readers.aria_mps.format import AriaTrajectory
from prbench.readers.aria_mps.to_recording import part_poses
from prbench.readers.aria_mps.trajectory import read_trajectory
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.files import POINT_FILES, EgoalloInputs
from prbench.readers.files import Source, opened
from prbench.recording import PoseStream

_FPS = 30.0
_POINT_COLUMNS = ("uid", "graph_uid", "px_world", "py_world", "pz_world", "inv_dist_std", "dist_std")
_GRAVITY = 9.81
_FLOOR_POINTS = 40  # a grid of so many by so many points over so many metres
_FLOOR_EDGE = 4.0
_SURE = (1e-6, 1e-4)  # inv_dist_std, dist_std: below the strictest limits
_UNUSED = tuple(f"{what}_{axis}_device" for what in ("device_linear_velocity", "angular_velocity") for axis in "xyz")


@dataclass(frozen=True)
class Prepared:
    """A folder for EgoAllo's ``--traj-root``."""

    folder: Path
    trajectory: Path
    frames: int
    """Output frames that cover the whole recording."""
    has_wrists: bool

    @property
    def outputs(self) -> Path:
        """The folder into which EgoAllo writes."""
        return self.folder / ego.OUTPUT_FOLDER


def guidance_mode(prepared: Prepared) -> str:
    """EgoAllo's ``--guidance-mode``: by tracked wrists where there are some, as the study does, else by feet alone."""
    return "aria_wrist_only" if prepared.has_wrists else "no_hands"


def prepare(inputs: EgoalloInputs, folder: Path) -> Prepared:
    """Write a recording's inputs into a folder; large files are linked, not copied, where that is possible.

    Raises:
        InputFileError: for a damaged input, or a trajectory too short or too slow for EgoAllo.
        StorageError: if the folder cannot be written.
    """
    trajectory = source_trajectory(inputs)
    place = folder / mps.SLAM_FOLDER / mps.TRAJECTORY_FILE
    # A trajectory is written anew only where it has to change: turned to Z up, or without poses that are no poses.
    # Everything else keeps the bytes of the dataset.
    if inputs.turned is not None or trajectory.left_out:
        _write_trajectory(place, trajectory)
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
    return Prepared(folder, place, _frames(inputs, trajectory), inputs.wrists is not None)


def source_trajectory(inputs: EgoalloInputs) -> AriaTrajectory:
    """The poses that EgoAllo is given: the recording's own, or (in a world with Y up) turned and at 1 kHz.

    Raises:
        InputFileError: if the trajectory is damaged.
    """
    trajectory = read_trajectory(inputs.trajectory)
    return trajectory if inputs.turned is None else inputs.turned(trajectory)


def head_poses(inputs: EgoalloInputs, trajectory: AriaTrajectory) -> PoseStream:
    """Central pupil frame in the world of EgoAllo's outputs, device seconds."""
    size = inputs.glasses_size
    if inputs.calibration is not None:
        size = read_first_calibration(inputs.calibration).size
    valid = np.ones(len(trajectory.time_us), dtype=bool)
    device = PoseStream(trajectory.time_us / 1e6, trajectory.position, trajectory.rotation, valid)
    return part_poses(device, mps.device_from_cpf(size))


def _write_trajectory(path: Path, trajectory: AriaTrajectory) -> None:
    """Write ``closed_loop_trajectory.csv`` (docs/specification/aria-mps.md#closed-loop-trajectory).

    Raises:
        StorageError: if the disk is full or the folder cannot be written.
    """
    n = len(trajectory.time_us)
    rotation = dict(zip(mps.ROTATION_COLUMNS, trajectory.rotation.T, strict=True))
    # Ours are scalar first; the columns of the file are qx, qy, qz, qw.
    scalar_last = (*mps.ROTATION_COLUMNS[1:], mps.ROTATION_COLUMNS[0])
    columns = {
        mps.GRAPH_COLUMN: np.full(n, trajectory.graph_uids[0]),
        mps.TIME_COLUMN: trajectory.time_us,
        "utc_timestamp_ns": np.full(n, -1),
        **dict(zip(mps.POSITION_COLUMNS, trajectory.position.T, strict=True)),
        **{name: rotation[name] for name in scalar_last},
        **dict.fromkeys(_UNUSED, np.zeros(n)),
        **dict(zip(mps.GRAVITY_COLUMNS, np.tile(-_GRAVITY * trajectory.up, (n, 1)).T, strict=True)),
        mps.QUALITY_COLUMN: trajectory.quality,
    }
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        _write_csv(file, pa.table(columns))


def _frames(inputs: EgoalloInputs, trajectory: AriaTrajectory) -> int:
    """Frames of an output for the whole recording: EgoAllo's own sampling, less the first pose.

    Raises:
        InputFileError: if its rule would take no pose at all, or fewer than two.
    """
    n = len(trajectory.time_us)
    seconds = float(trajectory.time_us[-1] - trajectory.time_us[0]) / 1e6
    # As EgoAllo's own script does it, rounding included: it takes every int(rate / 30)-th pose, and its outputs have
    # one frame less than it takes poses.
    step = int(n / seconds // _FPS) if seconds > 0 else 0
    frames = math.ceil(n / step) - 1 if step else 0
    if frames < 1:
        raise InputFileError(
            inputs.found.folder,
            "trajectory",
            expected=f"a trajectory of more than {_FPS:.0f} poses a second and of at least two output frames",
            found=f"{n} poses in {seconds:.3f} s",
            remedy="EgoAllo takes every int(rate / 30)-th pose and would take none.",
        )
    return frames


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
    shutil.copyfile(source, place)


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
        if len(content) > LARGEST_FILE:
            raise InputFileError(str(source), "", expected=f"at most {LARGEST_FILE:,} bytes unpacked", found="more")
        try:
            table = pyarrow.csv.read_csv(pa.BufferReader(content))
            x, y, z = (table[name] for name in _POINT_COLUMNS[2:5])
        except (pa.ArrowInvalid, KeyError) as error:
            raise InputFileError(
                str(source), "", expected="points with px_world, py_world, pz_world", found=str(error).splitlines()[0]
            ) from error
        # (x, y, z) with Y up is (x, -z, y) with Z up.
        below = pa.array(-z.to_numpy())
        for name, values in zip(_POINT_COLUMNS[2:5], (x, below, y), strict=True):
            table = table.set_column(table.column_names.index(name), name, values)
    # Without name and time, equal points are equal files.
    with (
        atomic_path(place) as temporary,
        open(temporary, "wb") as packed,
        gzip.GzipFile("", "wb", compresslevel=1, fileobj=packed, mtime=0) as file,
    ):
        _write_csv(file, table)


def _write_csv(file: IO[bytes] | gzip.GzipFile, table: pa.Table) -> None:
    # Arrow would put the column names in quotes, which Project Aria's files have not.
    file.write((",".join(table.column_names) + "\n").encode())
    options = pyarrow.csv.WriteOptions(include_header=False, quoting_style="none")
    pyarrow.csv.write_csv(table, pa.PythonFile(file, mode="w"), options)
