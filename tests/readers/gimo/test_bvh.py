"""BVH files: hierarchy, channel orders, and forward kinematics against cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.readers.gimo.bvh import joint_positions, read_bvh
from prbench.readers.gimo.synthetic import write_bvh
from tests.comparing import differences
from tests.readers.gimo_sample import skeleton

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
    positions = joint_positions(motion)
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
    np.testing.assert_allclose(joint_positions(motion)[0, 2], expected, atol=1e-12)


def test_writing_and_reading_change_nothing(tmp_path) -> None:
    motion = skeleton()
    write_bvh(motion, tmp_path / "s.bvh")
    assert list(differences(read_bvh(tmp_path / "s.bvh"), motion)) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            ("MOTION", "MOVEMENT"),
            r"sections HIERARCHY and MOTION, found 'HIERARCHY.* and no MOTION\. The file may be truncated",
        ),
        (("CHANNELS 0", "CHANNELS 1 Wrotation"), "at Other: expected a channel such as"),
        (("OFFSET 0 0 3", "OFFSET 0 0 x"), "at Other: expected a number, found 'x'"),
        (("}\nMOTION", "MOTION"), "expected closed braces"),
        (("Frames: 2", "Frames: 3"), "MOTION: expected 3 frames of 9 numbers"),
        (("Frame Time: 0.0083333", "Frame Time: 0"), "more than 0 s apart"),
        (("1 2 3", "1 2 three"), "MOTION: expected frames of numbers"),
    ],
)
def test_a_damaged_file_says_where(tmp_path, change, says) -> None:
    path = written(tmp_path)
    assert change[0] in path.read_text()
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(InputFileError, match=says):
        read_bvh(path)
