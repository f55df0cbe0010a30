"""A long synthetic recording as the Machine Perception Services write it, plain and zipped."""

from __future__ import annotations

import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps.synthetic import sense_mps, write_mps
from prbench.synthetic.people import perform

START_US = 149_000_000_000
_EVENTS = 4  # about half a minute, which is repeated


def write_recording(folder: Path, *, minutes: float) -> int:
    """Write ``plain/`` and ``recording.zip`` below a folder.

    Returns:
        Bytes of trajectory and gaze.
    """
    performance = perform("hd-epic", seed=0, index=0, n_events=_EVENTS)
    readings = sense_mps(performance, start_us=START_US, gaze_kind="general", step_jitter_us=2)
    turns = int(np.ceil(minutes * 60 / performance.duration))
    root = folder / "plain"
    write_mps(replace(readings, gaze=_repeated(readings, turns)), root)
    trajectory = root / mps.SLAM_FOLDER / mps.TRAJECTORY_FILE
    _write_long(trajectory, readings.trajectory.time_us, rows=int(minutes * 60_000))
    files = [path for path in sorted(root.rglob("*.*")) if path.is_file()]
    with zipfile.ZipFile(folder / "recording.zip", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path in files:
            archive.write(path, path.relative_to(root).as_posix())
    for path in (*files, folder / "recording.zip"):
        os.utime(path, (1_600_000_000, 1_600_000_000))  # files that just changed are not kept
    return sum(path.stat().st_size for path in files if path.suffix == ".csv" and path.parent.name != mps.HAND_FOLDER)


def _repeated(readings: mps.MpsReadings, turns: int) -> mps.GazeAngles:
    gaze, length = readings.gaze, _turn_us(readings.trajectory.time_us)
    times = np.concatenate([gaze.time_us + turn * length for turn in range(turns)])
    others = ("yaw", "pitch", "depth", "yaw_range", "pitch_range")
    return mps.GazeAngles(times, *(np.concatenate([getattr(gaze, name)] * turns) for name in others))


def _turn_us(time_us: np.ndarray) -> int:
    return int(time_us[-1] - time_us[0]) + 1000


def _write_long(path: Path, time_us: np.ndarray, *, rows: int) -> None:
    """Repeat the rows of a short trajectory on a running clock, with as many decimals as the real files have."""
    lines = path.read_text().splitlines()
    names = lines[0].split(",")
    cells = [line.split(",") for line in lines[1:]]
    before, after = cells[0][0], [",".join(map(_as_written, names[2:], row[2:])) for row in cells]
    with open(path, "w", encoding="utf-8", newline="\n") as file:
        file.write(lines[0] + "\n")
        for turn in range(-(-rows // len(cells))):
            times = (time_us + turn * _turn_us(time_us)).tolist()
            count = min(rows - turn * len(cells), len(cells))
            file.write("".join([f"{before},{times[row]},{after[row]}\n" for row in range(count)]))


def _as_written(name: str, cell: str) -> str:
    if name in ("utc_timestamp_ns", "geo_available", mps.QUALITY_COLUMN):
        return "1686767222002923694" if name == "utc_timestamp_ns" else cell
    return f"{float(cell):.{9 if name.startswith('q') else 6}f}"
