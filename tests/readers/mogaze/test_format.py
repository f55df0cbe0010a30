"""MoGaze's human model and gaze formula, against golden values, the model's own file, and SciPy."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.geometry.skeleton import Y_UP_FROM_Z_UP, Joint
from prbench.protocol.manifests import load_manifest
from prbench.readers.mogaze import format as mogaze
from prbench.readers.mogaze.format import (
    HEAD_FROM_CPF,
    LINKS,
    MODEL_OFFSETS,
    OFFSET_KEYS,
    PARENT_LINKS,
    STATE_COLUMNS,
    body_joints,
    intrinsic_xyz,
    link_offsets,
    link_poses,
)

GOLDEN = ("golden_zero", "golden_smooth_a", "golden_smooth_b", "golden_random_angles")


@pytest.fixture(params=GOLDEN)
def golden(request, samples) -> dict[str, np.ndarray]:
    with np.load(samples / "mogaze" / "golden" / f"{request.param}.npz", allow_pickle=False) as file:
        return {name: file[name] for name in file}


def _offsets(golden) -> np.ndarray:
    return link_offsets(dict(zip(golden["fixed_keys"].tolist(), golden["fixed_values"].tolist(), strict=True)))


def test_positions_rotations_and_head_are_the_golden_ones(golden) -> None:
    assert tuple(golden["description"].tolist()) == STATE_COLUMNS
    assert tuple(golden["joint_names"].tolist()) == LINKS
    positions, rotations = link_poses(golden["state"], _offsets(golden))
    assert positions == pytest.approx(golden["positions"], abs=1e-9)
    assert rotations == pytest.approx(golden["rotations"], abs=1e-9)
    forward = rotations[:, LINKS.index("head")] @ np.array(HEAD_FROM_CPF)[:, 2]
    assert forward == pytest.approx(golden["head_forward"], abs=1e-9)


def test_gaze_is_the_golden_one(golden) -> None:
    pose = golden["goggles_pose"]
    directions = mogaze.gaze_directions(
        Rotation.from_quat(pose[:, 3:]).as_matrix(),
        Rotation.from_quat(golden["calibration_xyzw"]).as_matrix(),
        golden["gaze_point"],
    )
    assert directions == pytest.approx(golden["gaze_direction"], abs=1e-9)


def test_a_gaze_point_behind_the_camera_is_mirrored_and_none_is_no_direction() -> None:
    upright = np.tile(np.eye(3), (3, 1, 1))
    points = np.array([(0.0, 300.0, 400.0), (0.0, -300.0, -400.0), (0.0, 0.0, 0.0)])
    directions = mogaze.gaze_directions(upright, np.eye(3), points)
    assert directions[:2] == pytest.approx(np.tile((0.0, 0.6, 0.8), (2, 1)))
    assert np.isnan(directions[2]).all()


def test_the_chain_is_that_of_the_player_s_model(samples) -> None:
    root = ET.parse(samples / "mogaze" / "human.urdf").getroot()
    joints = [(_link(joint, "parent"), _link(joint, "child"), joint) for joint in root.findall("joint")]
    parent = {child: above for above, child, _ in joints}
    assert {name for name in parent if "Trans" in name and not name.startswith("base")} == MODEL_OFFSETS
    axes = {child: [float(part) for part in _part(joint, "axis").get("xyz", "").split()] for _, child, joint in joints}
    assert all(axes[name] == np.eye(3)["XYZ".index(name[-1])].tolist() for name in axes)
    origins = [joint.find("origin") for _, _, joint in joints]
    assert all(o is None or set(f"{o.get('xyz')} {o.get('rpy')}".split()) <= {"0", "0."} for o in origins)
    for link, above in PARENT_LINKS.items():
        chain = [f"{link}Rot{axis}" for axis in "ZYX"]
        assert [parent[name] for name in chain[:2]] == chain[1:], f"{link} turns about X, then Y, then Z"
        name = parent[chain[-1]]
        while "Trans" in name:
            name = parent[name]
        assert name == (f"{above}RotZ" if above else "base")


def _link(joint: ET.Element, role: str) -> str:
    return _part(joint, role).get("link", "")


def _part(joint: ET.Element, name: str) -> ET.Element:
    entry = joint.find(name)
    assert entry is not None
    return entry


def test_angles_are_intrinsic_x_y_z() -> None:
    angles = np.random.default_rng(1).uniform(-3, 3, (50, 3))
    assert intrinsic_xyz(angles) == pytest.approx(Rotation.from_euler("XYZ", angles).as_matrix(), abs=1e-12)


def test_offsets_are_neither_clamped_nor_taken_from_joints_that_the_model_lacks() -> None:
    fixed = dict.fromkeys(OFFSET_KEYS, 0.0) | {"lKneeTransZ": -0.4, "lKneeTransX": 0.7, "lShoulderTransX": 4.0}
    offsets = link_offsets(fixed)
    assert offsets[LINKS.index("lKnee")].tolist() == [0.0, 0.0, -0.4]
    assert offsets[LINKS.index("lShoulder")].tolist() == [4.0, 0.0, 0.0]
    del fixed["lKneeTransZ"]
    with pytest.raises(KeyError, match="lKneeTransZ"):
        link_offsets(fixed)


def test_the_zero_pose_faces_forward_with_its_left_on_the_left(samples) -> None:
    with np.load(samples / "mogaze" / "golden" / "golden_zero.npz") as golden:
        positions, _ = link_poses(golden["state"], _offsets(golden))
    joints = body_joints(positions, load_manifest("mogaze").body.joint_mapping) @ Y_UP_FROM_Z_UP[:3, :3].T
    assert joints[0, Joint.LEFT_WRIST, 0] > 0.5 > -0.5 > joints[0, Joint.RIGHT_WRIST, 0]
    assert joints[0, Joint.HEAD, 1] > joints[0, Joint.PELVIS, 1] > joints[0, Joint.LEFT_FOOT, 1]
    assert joints[0, Joint.LEFT_FOOT, 2] > joints[0, Joint.LEFT_ANKLE, 2] + 0.1, "toes point along +Z"


def test_the_joint_mapping_by_hand() -> None:
    positions = np.zeros((1, len(LINKS), 3))
    positions[0, LINKS.index("pelvis")] = (0.0, 0.0, 1.0)
    positions[0, LINKS.index("torso")] = (0.0, 0.0, 2.0)
    body = load_manifest("mogaze").body
    spine = [Joint.PELVIS, Joint.SPINE1, Joint.SPINE2, Joint.SPINE3]
    assert body_joints(positions, body.joint_mapping)[0, spine, 2] == pytest.approx([1.0, 1.37, 1.82, 2.0])
    assert body_joints(positions, ["pelvis + torso"] * 22)[0, :, 2] == pytest.approx([1.5] * 22)


def test_head_axes_are_left_up_and_forward() -> None:
    face = np.array(HEAD_FROM_CPF)
    assert face[:, 0].tolist() == [1, 0, 0]
    assert face[:, 1].tolist() == [0, 0, 1]
    assert face[:, 2].tolist() == [0, -1, 0]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("cup_red", "cup"),
        ("plate_blue_2", "plate"),
        ("jug_3", "jug"),
        ("laiva_shelf", "laiva_shelf"),
        ("red_chair", "chair"),
    ],
)
def test_kinds_of_bodies(name, kind) -> None:
    assert mogaze.kind_of_body(name) == kind
    assert mogaze.is_furniture(name) == (kind in ("laiva_shelf", "chair"))
