"""Clips before they are encoded: canonical frame and 20 frames a second."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint, facing_yaw
from prbench.representation import canonicalise, check_joints, encode, retarget
from tests.fakes import STANDING, smooth_motion
from tests.representation.motions import turned


def test_the_canonical_frame_is_that_of_the_tables():
    joints = (turned(smooth_motion("clip", 30), 2.2) + np.array([3.0, -0.4, 1.0])).astype(np.float32)
    canonical = canonicalise(joints)
    assert canonical.dtype == np.float32
    assert np.allclose(canonical[0, 0, ::2], 0.0, atol=1e-6)
    assert facing_yaw(canonical[0]) == pytest.approx(0.0, abs=1e-6)
    assert canonical[..., 1].min() == pytest.approx(0.0, abs=1e-6)
    assert np.allclose(canonicalise(canonical), canonical, atol=1e-6)


DOORS = [encode, canonicalise, retarget]


def moving(n_frames: int = 6) -> np.ndarray:
    return smooth_motion("checks", n_frames)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_not_finite_is_named(door, value):
    joints = moving()
    joints[4, Joint.LEFT_WRIST, 1] = value
    with pytest.raises(InputFileError, match=r"clip\.npy, frame 4, left_wrist: expected a finite position"):
        door(joints, source="clip.npy")


@pytest.mark.parametrize("door", DOORS)
def test_a_wrong_joint_count_is_named(door):
    with pytest.raises(InputFileError, match=r"expected joint positions of the shape \(frames, 22, 3\).*\(6, 24, 3\)"):
        door(np.zeros((6, 24, 3)))


@pytest.mark.parametrize("door", DOORS)
def test_millimetres_are_named(door):
    with pytest.raises(InputFileError, match=r"expected a body in metres.*divide by 1,000"):
        door(moving() * 1000)


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize(("axes", "named"), [([0, 2, 1], "z"), ([1, 0, 2], "x")])
def test_another_axis_that_points_up_is_named(door, axes, named):
    joints = moving()[..., axes]
    with pytest.raises(InputFileError, match=rf"along \+y.*nearest to {named}\. Turn the axes"):
        door(joints)
    assert np.isfinite(door(joints, upright=False)).all()  # a person may lie


def test_hanging_upside_down_is_named_too():
    with pytest.raises(InputFileError, match="nearest to -y"):
        check_joints(moving() * (1, -1, 1))


@pytest.mark.parametrize(("lean", "refused"), [(59.0, False), (61.0, True)])
def test_sixty_degrees_are_the_limit(lean, refused):
    ankles, head = STANDING[[7, 8]].mean(axis=0), STANDING[15]
    own = np.arctan2(head[2] - ankles[2], head[1] - ankles[1])
    angle = np.deg2rad(lean) - own
    cos, sin = np.cos(angle), np.sin(angle)
    leaning = STANDING @ np.array([[1, 0, 0], [0, cos, sin], [0, -sin, cos]])
    if refused:
        with pytest.raises(InputFileError, match="61 degrees"):
            check_joints(np.stack([leaning, leaning]))
    else:
        check_joints(np.stack([leaning, leaning]))


@pytest.mark.parametrize("door", DOORS)
def test_a_bone_without_length_is_named(door):
    joints = moving()
    joints[2, Joint.HEAD] = joints[2, Joint.NECK]
    with pytest.raises(InputFileError, match=r"frame 2, head: expected a distance from neck"):
        door(joints)


def test_a_single_frame_has_no_step():
    with pytest.raises(InputFileError, match="expected 2 frames or more, found 1"):
        encode(moving(1))
    with pytest.raises(InputFileError, match="expected 2 frames or more, found 0"):
        encode(moving(1)[:0])


def test_the_next_frame_is_checked_as_well():
    with pytest.raises(InputFileError, match="frame 6, pelvis"):
        encode(moving(), next_joints=np.full((22, 3), np.nan))


def test_a_pose_that_faces_nowhere_cannot_be_canonical():
    joints = moving()
    joints[0, [1, 2, 16, 17]] = joints[0, [1, 2, 16, 17]] * (0, 1, 0)
    with pytest.raises(InputFileError, match=r"clip\.npy, frame 0: expected a pose with a heading"):
        canonicalise(joints, source="clip.npy")


def test_torch_is_not_imported_by_the_numpy_side_or_the_controls():
    code = "import sys, prbench.representation, prbench.harness.controls; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
