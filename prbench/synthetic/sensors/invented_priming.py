"""A stand-in for HD-EPIC's own priming pipeline, which is not released.

Independent of prbench's rule, so that comparing both finds something: it knows the true gaze, looks once a video frame,
tests the distance between a point and the gaze ray, begins the window of a put no earlier than the lift, and leaves out
events that are off screen or that gaze meets already ten seconds before.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prbench.axes import Y_UP_FROM_Z_UP
from prbench.readers.hd_epic import format as hd_epic
from prbench.skeleton import transform_points
from prbench.synthetic.performance import Performance
from prbench.synthetic.sensors.errors import sensor_generator

_WINDOW = 300  # frames
_NEAR = 0.10  # m
_IN_VIEW = np.cos(np.deg2rad(50.0))  # half of the camera's field of view
_FORGOTTEN = 0.02  # share of the events that the file does not mention


def invented_priming(
    performance: Performance, tracks: Sequence[hd_epic.ObjectTrack]
) -> tuple[hd_epic.PublishedSide, ...]:
    """One entry for every end of a movement that has a mask, but for a few."""
    rng = sensor_generator(performance, "published-priming")
    entries = []
    for number, track in enumerate(tracks):
        forgotten = rng.random(2) < _FORGOTTEN
        start, end = round(track.start * hd_epic.FPS), round(track.end * hd_epic.FPS)
        for mask in track.masks:
            if mask.location is None or mask.frame not in (start, end) or forgotten[int(mask.frame == end)]:
                continue
            is_start = mask.frame == start
            first = max(start - _WINDOW, 0) if is_start else max(end - _WINDOW, start)
            primed = _first_look(performance, mask, first)
            key = f"{number}/{'start' if is_start else 'end'}"
            entries.append(hd_epic.PublishedSide(key, is_start, mask.frame, mask.location, primed))
    return tuple(sorted(entries, key=lambda entry: (int(entry.key.split("/")[0]), not entry.is_start)))


def _first_look(performance: Performance, mask: hd_epic.ObjectMask, first: int) -> int:
    """The frame of the first look, or -1, or -2 for an event that is not tested."""
    assert mask.location is not None
    goal = transform_points(Y_UP_FROM_Z_UP, mask.location)
    if not _in_view(performance, goal, mask.frame):
        return hd_epic.EXCLUDED
    for frame in range(first, mask.frame + 1):
        row = _row(performance, frame)
        towards = goal - performance.eye[row]
        along = float(towards @ performance.gaze[row])
        beside = float(np.linalg.norm(towards - along * performance.gaze[row]))
        if along > 0 and beside <= _NEAR:
            at_once = frame == first and mask.frame - first == _WINDOW
            return hd_epic.EXCLUDED if at_once else frame
    return hd_epic.NOT_PRIMED


def _in_view(performance: Performance, goal: np.ndarray, frame: int) -> bool:
    row = _row(performance, frame)
    w, x, y, z = performance.head_rotation[row]
    forward = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    towards = goal - performance.eye[row]
    return bool(towards @ forward >= _IN_VIEW * np.linalg.norm(towards))


def _row(performance: Performance, frame: int) -> int:
    """Row of the performance nearest to a video frame."""
    return min(round(frame / hd_epic.FPS * performance.rate), len(performance.times) - 1)
