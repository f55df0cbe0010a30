"""``eye_pc``: where the gaze meets the scan (docs/specification/gimo.md#gaze)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from prbench.errors import InputFileError
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.ply import count_vertices, read_vertices


def read_gaze(cones: Mapping[int, Path], centres: Mapping[int, Path]) -> tuple[gimo.GazePoints, tuple[str, ...]]:
    """The gaze point of every frame that has one: the first vertex of ``<frame>_center.ply``.

    A frame has none when one of its two files is missing, damaged or without vertices, or when the point is the origin.

    Args:
        cones: ``<frame>.ply`` by frame: scene points inside the cone of the gaze; only counted.
        centres: ``<frame>_center.ply`` by frame.

    Returns:
        The points, and remarks about damaged files.
    """
    frames, points = [], []
    damaged: list[InputFileError] = []
    for frame in sorted(cones.keys() & centres.keys()):
        try:
            vertices = read_vertices(centres[frame])
            seen = len(vertices) > 0 and count_vertices(cones[frame]) > 0
        except InputFileError as error:
            damaged.append(error)
            continue
        if seen and np.isfinite(vertices[0]).all() and np.abs(vertices[0]).sum() >= gimo.NO_POINT:
            frames.append(frame)
            points.append(vertices[0])
    found = gimo.GazePoints(np.array(frames, dtype=np.int64), np.array(points, dtype=np.float64).reshape(-1, 3))
    return found, _remarks(damaged)


def _remarks(damaged: list[InputFileError]) -> tuple[str, ...]:
    if not damaged:
        return ()
    first = damaged[0]
    return (
        f"{len(damaged)} damaged gaze files are left out, first: {first.path.name}: expected {first.expected}, found"
        f" {first.found}",
    )
