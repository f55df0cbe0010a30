"""Small copies of HD-EPIC for tests: a synthetic tree of two videos, and ways to change its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prbench.readers.aria_mps import format as mps
from prbench.readers.hd_epic import format as hd_epic
from prbench.synthetic.people.perform import name_of_recording
from prbench.synthetic.write_tree import synthesize_tree

SEED = 3
FIRST, SECOND = (name_of_recording("hd-epic", SEED, index) for index in (0, 1))


def write_copy(root: Path) -> Path:
    synthesize_tree("hd-epic", root, recordings=2, seed=SEED, n_events=2, provocations={})
    return root


def annotation(root: Path, name: str) -> Path:
    return root / hd_epic.ANNOTATIONS_FOLDER / hd_epic.MOVEMENTS_FOLDER / name


def time_file(root: Path, video: str) -> Path:
    (path,) = root.glob(f"HD-EPIC/Videos/*/{video}{hd_epic.TIME_SUFFIX}")
    return path


GLASSES_START_NS = 7_000_000_000


def still_glasses(confidence: float = 1.0) -> mps.MpsReadings:
    """Three seconds of still glasses, and a right wrist that is seen with one confidence."""
    time_us = GLASSES_START_NS // 1000 + np.arange(0, 3_000_000, 1000)
    n, upright = len(time_us), np.array([1.0, 0.0, 0.0, 0.0])
    gaze_us = time_us[::100]
    angles, ranges = np.zeros(len(gaze_us)), np.zeros((len(gaze_us), 2))
    points = np.full((len(gaze_us), 2, 3), np.nan)
    points[:, 1] = (0.1, 0.2, 0.3)
    return mps.MpsReadings(
        mps.AriaTrajectory(
            time_us, np.zeros((n, 3)), np.tile(upright, (n, 1)), np.ones(n), np.array([0.0, 0.0, 1.0]), ("w",), 0
        ),
        mps.GazeAngles(gaze_us, angles, angles, angles, ranges, ranges),
        "general",
        mps.WristPositions(gaze_us, np.tile([-1.0, confidence], (len(gaze_us), 1)), points, points),
        "DVT-S",
        None,
    )
