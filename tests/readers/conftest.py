from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prbench.readers.adt import format as adt
from prbench.readers.adt import synthetic as layout
from prbench.readers.adt.synthetic import suit_joints

START_US = 5_000_000_000
FORK, TABLE, SOFA = 3758151980953788, 9007199254740993, 4443332221110000  # the second is no float64

STANDING = np.array(
    [
        (0.0, 0.95, 0.0), (0.06, 0.87, 0.0), (-0.06, 0.87, 0.0), (0.0, 1.05, 0.0), (0.1, 0.48, 0.0), (-0.1, 0.48, 0.0),
        (0.0, 1.18, 0.0), (0.1, 0.08, 0.0), (-0.1, 0.08, 0.0), (0.0, 1.3, 0.0), (0.1, 0.04, 0.14), (-0.1, 0.04, 0.14),
        (0.0, 1.5, 0.0), (0.07, 1.42, 0.0), (-0.07, 1.42, 0.0), (0.0, 1.6, 0.03), (0.18, 1.42, 0.0), (-0.18, 1.42, 0.0),
        (0.22, 1.14, 0.0), (-0.22, 1.14, 0.0), (0.22, 0.95, 0.18), (-0.22, 0.95, 0.18),
    ]
)  # fmt: skip
FINGER_BASES = np.add(STANDING[20:], (0.0, 0.0, 0.08))


def still_life() -> adt.AdtReadings:
    """One second of a person who stands still at a table and looks straight ahead."""
    pose_us = START_US + np.rint(np.arange(31) * 1e6 / 30).astype(np.int64)
    body_ns = START_US * 1000 + np.rint(np.arange(121) * 1e9 / 120).astype(np.int64)
    upright = np.tile([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], (31, 1))
    joints = suit_joints(np.tile(STANDING, (121, 1, 1)), np.tile(FINGER_BASES, (121, 1, 1)))
    return adt.AdtReadings(
        recording_id="still_life",
        serial="S1",
        concurrent="",
        glasses_size=None,
        device_from_rgb=None,
        glasses=adt.AriaTrajectory(pose_us, np.tile((0.0, 1.6, 0.0), (31, 1)), upright, np.full(31, 0.9)),
        gaze=adt.GazeAngles(pose_us - 3, np.zeros(31), np.zeros(31), np.ones(31), np.zeros((31, 2)), np.zeros((31, 2))),
        objects=(
            _object(FORK, "WoodenFork", "fork", pose_us * 1000 + 700, (0.3, 0.9, 0.4), (0.01, 0.01, 0.1)),
            _object(TABLE, "Table", "table", np.array([-1]), (0.0, 0.4, 0.5), (0.5, 0.4, 0.3)),
            _object(adt.SCENE_BOX_ID, "ApartmentEnv", "shelter", np.array([-1]), (0.0, 1.4, 0.0), (6.0, 1.5, 6.0)),
        ),
        skeletons=(adt.AdtSkeleton("Skeleton_T", 77, "S1", body_ns, joints),),
    )


def _object(key, name, category, time_ns, centre, half) -> adt.AdtObject:
    half_extents, n = np.array(half), len(time_ns)
    pose = np.tile(np.array(centre), (n, 1)), np.tile((1.0, 0.0, 0.0, 0.0), (n, 1))
    return adt.AdtObject(key, name, name, category, n > 1, -half_extents, half_extents, time_ns, *pose)


@pytest.fixture
def readings() -> adt.AdtReadings:
    return still_life()


@pytest.fixture
def folder(tmp_path) -> Path:
    """The still life as native files, ready to be damaged."""
    layout.write(still_life(), tmp_path / "still_life")
    return tmp_path / "still_life"
