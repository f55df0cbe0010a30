"""BVH files: hierarchy, channel orders, and forward kinematics against cases worked by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.readers.gimo.bvh import BvhMotion, joint_poses, place_skeleton, read_bvh, write_bvh
from tests.comparing import differences
from tests.fakes import STANDING
from tests.readers.gimo_sample import LEAD, N_FRAMES, path_of_pelvis, skeleton

ARM = """HIERARCHY
ROOT Hips
{{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition {order}
  JOINT Upper Arm
  {{
    OFFSET 0 1 0
    CHANNELS 3 {order}
    End Site
    {{
      OFFSET 0 2 0
    }}
  }}
  JOINT Other
  {{
    OFFSET 0 0 3
    CHANNELS 0
  }}
}}
MOTION
Frames: 2
Frame Time: 0.0083333
1 2 3 {first}
0 0 0 {second}
"""


def written(tmp_path, *, order="Zrotation Xrotation Yrotation", first="0 0 0 0 0 0", second="0 0 0 0 0 0"):
    path = tmp_path / "a.bvh"
    path.write_text(ARM.format(order=order, first=first, second=second))
    return path


def test_a_turned_root_carries_its_children(tmp_path) -> None:
    motion = read_bvh(written(tmp_path, first="90 0 0 0 0 0"))  # about Z: up becomes -X
    assert [(joint.name, joint.parent) for joint in motion.joints] == [("Hips", -1), ("Upper Arm", 0), ("Other", 0)]
    assert motion.frame_time == pytest.approx(1 / 120, abs=1e-6)
    positions = joint_poses(motion)[0]
    np.testing.assert_allclose(positions[0], [[1, 2, 3], [0, 2, 3], [1, 2, 6]], atol=1e-12)
    np.testing.assert_allclose(positions[1], [[0, 0, 0], [0, 1, 0], [0, 0, 3]], atol=1e-12)


@pytest.mark.parametrize("order", ["Zrotation Xrotation Yrotation", "Yrotation Xrotation Zrotation"])
def test_the_order_of_channels_is_the_order_of_rotations(tmp_path, order) -> None:
    motion = read_bvh(written(tmp_path, order=order, first="30 -40 70 0 0 0"))
    matrices = [
        Rotation.from_euler(name[0].lower(), angle, degrees=True)
        for name, angle in zip(order.split(), (30, -40, 70), strict=True)
    ]
    turned = matrices[0] * matrices[1] * matrices[2]
    expected = np.array([1, 2, 3]) + turned.apply([0, 0, 3])
    np.testing.assert_allclose(joint_poses(motion)[0][0, 2], expected, atol=1e-12)


def test_writing_and_reading_change_nothing(tmp_path) -> None:
    motion = skeleton()
    write_bvh(motion, tmp_path / "s.bvh")
    assert list(differences(read_bvh(tmp_path / "s.bvh"), motion)) == []


SECONDS = 7.0 + np.arange(N_FRAMES) / 30


def laid(motion: BvhMotion, pelvis: np.ndarray | None = None):
    track = path_of_pelvis(SECONDS - 7.0) if pelvis is None else pelvis
    return place_skeleton(motion, SECONDS, track, "skeleton.bvh", 0.05)


@pytest.mark.parametrize("unit", [1.0, 100.0, 1000.0])
def test_time_and_unit_are_found(unit) -> None:
    joints, remarks = laid(skeleton(unit=unit))
    assert LEAD / 60 == 0.5
    assert remarks == [
        "limbs from skeleton.bvh, which begins 0.500 s before the segment and follows the fitted pelvis within 0 mm"
    ]
    expected = STANDING - STANDING[0] + path_of_pelvis(SECONDS - 7.0)[:, None]
    np.testing.assert_allclose(joints, expected, atol=1e-5)


def test_an_offset_of_the_hips_is_taken_away() -> None:
    shifted = skeleton()
    shifted.values[:, :3] += (30.0, -20.0, 5.0)  # centimetres
    np.testing.assert_allclose(laid(shifted)[0], laid(skeleton())[0], atol=1e-4)


REFUSED = {
    "another walk": (lambda motion: replace(motion, values=motion.values[::-1].copy()), "expected hips within 5 cm"),
    "a short file": (
        lambda motion: replace(motion, values=motion.values[:60]),
        r"at least the 1\.47 s .* found 0\.98 s",
    ),
    "long legs": (lambda _motion: skeleton(unit=7.0), r"expected legs of 0\.5 to 1\.2 m"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_skeleton_that_cannot_be_the_segments_is_refused(name) -> None:
    change, says = REFUSED[name]
    with pytest.raises(InputFileError, match=says):
        laid(change(skeleton()))


def test_who_stands_still_is_aligned_by_guess() -> None:
    standing = replace(skeleton(), values=np.tile(skeleton().values[0], (200, 1)))
    _, remarks = laid(standing, np.tile(path_of_pelvis(np.zeros(1)), (N_FRAMES, 1)))
    assert remarks[-1] == "the pelvis hardly moves, so the skeleton's start is a guess"
