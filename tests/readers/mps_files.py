"""Small files of the Machine Perception Services, made line by line."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from prbench.readers.aria_mps import format as mps
from prbench.readers.found import InputFile

WORLD, OTHER_WORLD = "ea7288b8-b6a0-012d-8156-257aba6bd796", "short"
COLUMNS = (
    "graph_uid", "tracking_timestamp_us", "utc_timestamp_ns", *mps.POSITION_COLUMNS, *mps.ROTATION_COLUMNS,
    "device_linear_velocity_x_device", *mps.GRAVITY_COLUMNS, "quality_score", "geo_available",
)  # fmt: skip


def trajectory_lines(
    time_us: np.ndarray, *, worlds: list[str] | None = None, quality: np.ndarray | None = None
) -> list[str]:
    """Header and rows: a device that slides along x, 1 mm a row, in numbers of many lengths."""
    rows = [",".join(COLUMNS)]
    for row, time in enumerate(time_us.tolist()):
        graph = WORLD if worlds is None else worlds[row]
        score = 1.0 if quality is None else quality[row]
        turn = 0.001 * row
        pose = [row / 1000, -1.5, 0.25 * (row % 3), np.cos(turn), 0, np.sin(turn), 0]
        velocity = f"{3e18 * (row % 7):.{row % 12}e}"  # as wild and as uneven as in a real file
        cells = [graph, time, -1, *pose, velocity, 0, 0, -9.81, score, 0]
        rows.append(",".join(str(cell) for cell in cells))
    return rows


def write_lines(path: Path, lines: list[str], *, end: str = "\n", last_end: str | None = None) -> Path:
    """The lines as a file; the last may end otherwise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes((end.join(lines) + (end if last_end is None else last_end)).encode())
    return path


def zipped(path: Path, *, below: str = "mps/slam") -> InputFile:
    """The file in an archive beside it."""
    archive = path.with_suffix(".zip")
    member = f"{below}/{path.name}"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as opened:
        opened.write(path, member)
    return InputFile("", archive, 0, member)


def gaze_lines(time_us: np.ndarray, *, yaw: float = 0.1) -> list[str]:
    """Header and rows of the oldest schema."""
    rows = [f"{mps.TIME_COLUMN},{mps.YAW},{mps.PITCH},{mps.DEPTH}"]
    return rows + [f"{time},{yaw},-0.2," for time in time_us.tolist()]
