"""Joints to features and back: laws, hand-worked rows, degenerate poses; clips before, bodies on one skeleton."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.errors import InputFileError
from prbench.geometry.skeleton import PARENTS, Joint, bone_lengths, facing_yaw
from prbench.representation import (
    BLOCKS,
    REST_OFFSETS,
    UniformSkeleton,
    canonicalise,
    check_joints,
    decode,
    encode,
    mirror,
    rest_offsets,
    retarget,
    root_scale,
)
from prbench.representation.features import BONE_LENGTHS, REST_DIRECTIONS
from tests.fakes import STANDING, smooth_motion
from tests.representation.motions import decode_rotations, turned, walk


@pytest.mark.parametrize("turn", [0.0, 2.0, -3.3, 20.0])
@pytest.mark.parametrize("n_frames", [2, 3, 4, 60, 241])
def test_every_encoded_frame_comes_back(n_frames, turn):
    joints = walk("back", n_frames, turn=turn)
    assert np.abs(decode(encode(joints)) - joints[:-1]).max() < 1e-6


def test_with_the_next_frame_there_are_as_many_rows_as_frames():
    joints = walk("rows", 50)
    features = encode(joints[:-1], next_joints=joints[-1])
    assert features.shape == (49, 263)
    assert features.dtype == np.float32
    assert np.array_equal(features, encode(joints))
    assert np.abs(decode(features) - joints[:-1]).max() < 1e-6


def test_a_copied_next_frame_costs_no_position_of_the_last():
    joints = walk("copy", 50)
    features = encode(joints, next_joints=joints[-1])
    assert np.abs(decode(features) - joints).max() < 1e-6
    assert np.allclose(features[-1, BLOCKS["joint_velocities"]], 0.0)
    assert np.array_equal(features[-1, BLOCKS["foot_contacts"]], np.ones(4))


@pytest.mark.parametrize("yaw", [0.3, 2.0, -2.9, np.pi])
def test_features_do_not_depend_on_where_the_clip_stood_in_the_world(yaw):
    world = turned(smooth_motion("world", 80), np.linspace(0, 4, 80))
    moved = turned(world, yaw) + np.array([5.0, 0.7, -11.0])
    expected, features = encode(canonicalise(world)), encode(canonicalise(moved))
    assert np.abs(features - expected).max() < 1e-5


def test_rows_of_a_straight_walk_by_hand():
    joints = np.repeat(STANDING[None], 5, axis=0)
    joints[:, :, 2] += 0.05 * np.arange(5)[:, None]  # 1 m/s at 20 fps
    row = encode(joints)[2]
    assert np.allclose(row[0:4], (0.0, 0.0, 0.05, 0.95), atol=1e-7)
    assert np.allclose(row[BLOCKS["joint_positions"]].reshape(21, 3), STANDING[1:], atol=1e-6)
    assert np.allclose(row[BLOCKS["joint_velocities"]].reshape(22, 3), (0.0, 0.0, 0.05), atol=1e-6)
    assert np.array_equal(row[BLOCKS["foot_contacts"]], np.zeros(4))  # 0.05 m a frame is faster than 0.0447 m


def test_feet_touch_the_ground_below_the_threshold_whatever_their_height():
    joints = np.repeat(STANDING[None], 4, axis=0)
    joints[1:, Joint.LEFT_ANKLE, 0] += 0.044  # m in the first frame only
    joints[2:, Joint.RIGHT_FOOT, 1] += 0.046
    contacts = encode(joints)[:, BLOCKS["foot_contacts"]]
    assert contacts.tolist() == [[1, 1, 1, 1], [1, 1, 1, 0], [1, 1, 1, 1]]


def test_yaw_velocity_is_half_the_turn_and_row_zero_jumps_from_the_identity():
    """Narrow hips: the original's exchanged hip sign then changes the heading by a constant only."""
    joints = turned(np.repeat(STANDING[None], 400, axis=0), 0.02 * np.arange(400))
    features = encode(joints)
    assert np.allclose(features[150:250, 0], -0.01, atol=1e-6)  # world to heading: the sign is turned round
    foreseen = 0.02 * 20 / np.sqrt(2 * np.pi)  # the smoothed heading of the start knows half of the turn to come
    assert features[0, 0] == pytest.approx(-(foreseen + 0.01) / 2, rel=0.05)


def test_rotation_features_turn_rest_directions_into_bones():
    """An independent walk along the chains with SciPy's rotations."""
    joints = walk("chains", 30)
    rows = encode(joints)
    yaw = 2 * np.concatenate([[0.0], np.cumsum(rows[:-1, 0], dtype=np.float64)])
    for t in (0, 13, 28):
        heading = Rotation.from_rotvec([0, yaw[t], 0])
        six = rows[t, BLOCKS["joint_rotations"]].reshape(21, 2, 3).astype(np.float64)
        for chain in ((2, 5, 8, 11), (1, 4, 7, 10), (3, 6, 9, 12, 15), (14, 17, 19, 21), (13, 16, 18, 20)):
            rotation = heading
            for joint in chain:
                first, second = six[joint - 1]
                rotation = rotation * Rotation.from_matrix(np.stack([first, second, np.cross(first, second)], axis=1))
                bone = joints[t, joint] - joints[t, PARENTS[joint]]
                assert np.allclose(rotation.apply(REST_DIRECTIONS[joint]), bone / np.linalg.norm(bone), atol=1e-5)


def test_rotations_are_the_shortest_from_rest():
    joints = walk("shortest", 20)
    six = encode(joints)[0, BLOCKS["joint_rotations"]].reshape(21, 2, 3).astype(np.float64)
    for joint in (1, 3, 14):  # the first bones of their chains, in frame 0, whose heading is the identity
        first, second = six[joint - 1]
        rotation = Rotation.from_matrix(np.stack([first, second, np.cross(first, second)], axis=1))
        bone = joints[0, joint] - joints[0, PARENTS[joint]]
        cosine = bone @ REST_DIRECTIONS[joint] / np.linalg.norm(bone)
        assert rotation.magnitude() == pytest.approx(np.arccos(cosine), abs=1e-5)


def test_rotations_give_the_motion_back_on_its_own_bones():
    pose = STANDING.astype(np.float32)
    spun = turned(np.repeat(pose[None], 90, axis=0), np.linspace(0, 2 * np.pi, 90)).astype(np.float32)
    features = encode(spun)
    assert np.abs(decode_rotations(features, rest_offsets(pose)) - spun[:-1]).max() < 2e-6


def test_a_bone_opposite_to_its_rest_direction_is_half_a_turn():
    joints = np.repeat(STANDING[None], 3, axis=0)
    for joint in range(1, 22):  # every bone, the shoulders' and hips' included
        joints[:, joint] = joints[:, PARENTS[joint]] - REST_OFFSETS[joint]
    features = encode(joints, upright=False)
    assert np.isfinite(features).all()
    assert np.abs(decode_rotations(features) - joints[:-1]).max() < 1e-6


def test_a_bone_next_to_opposite_keeps_its_direction():
    joints = np.repeat(STANDING[None], 3, axis=0)
    joints[:, Joint.RIGHT_WRIST] = joints[:, Joint.RIGHT_ELBOW] + np.array([1e-5, 0.27, 2e-5])
    recovered = decode_rotations(encode(joints), rest_offsets(joints[0]))
    assert np.abs(recovered - joints[:-1]).max() < 2e-6


def test_a_start_exactly_opposite_turns_by_half_a_turn():
    facing_back = STANDING * np.array([-1.0, 1.0, -1.0])
    joints = canonicalise(np.repeat(facing_back[None], 3, axis=0))
    assert np.allclose(joints, STANDING - np.array([0, STANDING[:, 1].min(), 0]), atol=1e-7)
    assert np.isfinite(encode(joints, mode="reference")).all()


def test_a_heading_exactly_opposite_is_half_a_turn_in_both_modes():
    symmetric = STANDING.copy()
    symmetric[[16, 17], 0] *= 0.1  # hips wider than shoulders: the exchanged sign turns the heading round
    joints = np.repeat(symmetric[None], 3, axis=0)
    for mode in ("continuous", "reference"):
        features = encode(joints, mode=mode)
        assert np.isfinite(features).all()
        assert abs(features[0, 0]) == pytest.approx(np.pi / 2)
        assert np.abs(decode(features) - joints[:-1]).max() < 1e-6


def test_no_heading_at_all_is_not_turned():
    level = STANDING.copy()
    level[[16, 17], 0] = level[[1, 2], 0]
    level[[16, 17], 2] = level[[1, 2], 2]  # the hips, with exchanged sign, cancel the shoulders
    joints = np.repeat(level[None], 4, axis=0)
    for mode in ("continuous", "reference"):
        features = encode(joints, mode=mode)
        assert np.array_equal(features[:, 0], np.zeros(3))
        assert np.abs(decode(features) - joints[:-1]).max() < 1e-6


def test_batches_decode_row_by_row():
    rows = np.stack([encode(walk(str(i), 40)) for i in range(6)]).reshape(2, 3, 39, 263)
    joints = decode(rows)
    assert joints.shape == (2, 3, 39, 22, 3)
    assert np.array_equal(joints[1, 2], decode(rows[1, 2]))


def test_the_mirror_exchanges_sides_and_comes_back():
    joints = walk("mirror", 10)
    image = mirror(joints)
    assert np.array_equal(image[:, Joint.LEFT_WRIST], joints[:, Joint.RIGHT_WRIST] * (-1, 1, 1))
    assert np.array_equal(image[:, Joint.HEAD], joints[:, Joint.HEAD] * (-1, 1, 1))
    assert np.array_equal(mirror(image), joints)


def test_features_of_the_mirror_turn_the_other_way():
    joints = walk("other way", 60)
    own, image = encode(joints), encode(mirror(joints))
    assert np.allclose(image[:, :4], own[:, :4] * (-1, -1, 1, 1), atol=1e-6)


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
@pytest.mark.parametrize(("axes", "named"), [([0, 2, 1], "z"), ([1, 0, 2], "x")])
def test_another_axis_that_points_up_is_named(door, axes, named):
    joints = moving()[..., axes]
    assert np.isfinite(door(joints, upright=False)).all()  # a person may lie


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


def test_torch_is_not_imported_by_the_numpy_side_or_the_controls():
    code = "import sys, prbench.representation.converters, prbench.harness.controls; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


SMALL = (STANDING * 0.6).astype(np.float32)


def unit_bones(joints: np.ndarray) -> np.ndarray:
    bones = joints[..., 1:, :] - joints[..., PARENTS[1:], :]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def test_every_bone_keeps_its_direction_and_takes_the_common_length():
    joints = walk("retarget", 20)
    uniform = retarget(joints)
    assert uniform.dtype == joints.dtype
    assert np.allclose(bone_lengths(uniform), BONE_LENGTHS[1:], atol=1e-6)
    assert np.allclose(unit_bones(uniform), unit_bones(joints), atol=1e-5)


def test_the_path_is_scaled_by_the_right_leg_alone():
    joints = walk("path", 20)
    thigh, shin = joints[0, [5, 8]] - joints[0, [2, 5]]
    scale = (0.390126109 + 0.425707549) / (np.linalg.norm(thigh) + np.linalg.norm(shin))
    assert root_scale(joints[0]) == pytest.approx(scale)
    assert np.allclose(retarget(joints)[:, Joint.PELVIS], joints[:, Joint.PELVIS] * scale, atol=1e-6)


def test_a_body_of_the_uniform_skeleton_stays_as_it_is():
    uniform = retarget(walk("twice", 20))
    assert np.allclose(retarget(uniform), uniform, atol=1e-6)


def test_own_bone_lengths_make_an_own_rest_skeleton():
    offsets = rest_offsets(SMALL)
    assert np.allclose(np.linalg.norm(offsets[1:], axis=-1), bone_lengths(SMALL))
    assert np.allclose(retarget(np.stack([SMALL, SMALL]), offsets=offsets), SMALL, atol=1e-6)


def test_conditions_go_in_and_motion_comes_back_at_the_body_s_scale():
    """A body proportioned as the uniform skeleton, at two sizes: the way there and back is the identity."""
    uniform = retarget(walk("sizes", 20))
    motions = np.stack([uniform * 0.7, uniform * 1.2]).astype(np.float32)
    goals = np.array([[0.5, 0.9, 1.5], [-1.0, 1.1, 0.4]])
    skeleton = UniformSkeleton.of(motions[:, 0])
    assert np.allclose(skeleton.scale, (1 / 0.7, 1 / 1.2))
    assert np.allclose(skeleton.poses(motions), uniform, atol=2e-6)
    assert np.allclose(skeleton.poses(motions[:, 0]), uniform[0], atol=2e-6)
    assert np.allclose(skeleton.locations(goals), goals / [[0.7], [1.2]])
    assert np.allclose(skeleton.own_scale(skeleton.poses(motions)), motions, atol=2e-6)
    assert np.allclose(skeleton.own_scale(skeleton.locations(goals)), goals)


def test_single_poses_of_a_batch_are_those_of_the_motion():
    motion = walk("pose", 10)
    skeleton = UniformSkeleton.of(motion[:1])
    assert np.allclose(skeleton.poses(motion[None])[0], retarget(motion), atol=1e-6)
