"""Posing of UmeTrack's hand against a slow independent implementation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prbench.readers.hot3d import hands as umetrack
from prbench.readers.hot3d.format import HandModel
from prbench.readers.hot3d.synthetic import finger_angles, synthetic_hand, wrist_rotation

WRIST_LANDMARK = 5
PALM_LANDMARK = 20

RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def model() -> HandModel:
    return synthetic_hand(0.08)


def _posed_slowly(
    model: HandModel, angles: np.ndarray, position: np.ndarray, rotation: np.ndarray, *, right: bool
) -> np.ndarray:
    """Vertex by vertex and bone by bone, as the three lines of the format page say."""

    def about(joint: int) -> np.ndarray:
        transform = np.eye(4)
        transform[:3, :3] = Rotation.from_rotvec(angles[joint] * model.joint_axes[joint]).as_matrix()
        back = np.eye(4)
        back[:3, 3] = -model.joint_positions[joint]
        forth = np.eye(4)
        forth[:3, 3] = model.joint_positions[joint]
        return forth @ transform @ back

    bones = [np.eye(4), np.eye(4)]
    for finger in range(5):
        chain = about(4 * finger)
        for k in (1, 2, 3):
            chain = chain @ about(4 * finger + k)
            bones.append(chain)
    wrist = np.eye(4)
    wrist[:3, :3] = Rotation.from_quat(rotation, scalar_first=True).as_matrix()
    wrist[:3, 3] = position
    if right:
        wrist[:3, 0] *= -1
    posed = []
    for vertex, weights in zip(model.vertices, model.weights, strict=True):
        mixed = sum(weight * bone @ np.append(vertex, 1.0) for weight, bone in zip(weights, bones, strict=True))
        posed.append((wrist @ mixed)[:3])
    return np.array(posed)


@pytest.mark.parametrize("right", [False, True])
def test_vertices_equal_the_slow_computation(model, right) -> None:
    angles = RNG.uniform(-1.0, 1.0, (3, umetrack.N_JOINTS))
    position, rotation = RNG.normal(size=(3, 3)), Rotation.random(3, rng=RNG).as_quat(scalar_first=True)
    bones = umetrack.bone_transforms(model, angles)
    fast = umetrack.pose_points(model.vertices, model.weights, bones, position, rotation, mirrored=right)
    for frame in range(3):
        slow = _posed_slowly(model, angles[frame], position[frame], rotation[frame], right=right)
        assert fast[frame] == pytest.approx(slow, abs=1e-12)


def test_a_hand_at_rest_is_its_rest_mesh(model) -> None:
    bones = umetrack.bone_transforms(model, np.zeros((1, umetrack.N_JOINTS)))
    origin, upright = np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]])
    left = umetrack.pose_points(model.vertices, model.weights, bones, origin, upright, mirrored=False)[0]
    right = umetrack.pose_points(model.vertices, model.weights, bones, origin, upright, mirrored=True)[0]
    assert left == pytest.approx(model.vertices)
    assert right == pytest.approx(model.vertices * [-1, 1, 1]), "a right hand is the mirror image"


def test_the_last_two_angles_move_nothing(model) -> None:
    angles = np.zeros((1, umetrack.N_JOINTS))
    angles[0, umetrack.N_ANGLES :] = 1.0
    assert umetrack.bone_transforms(model, angles)[0] == pytest.approx(np.tile(np.eye(4), (umetrack.N_BONES, 1, 1)))


def test_the_invented_hand_has_the_form_of_a_real_one(model) -> None:
    assert len(model.vertices) == 80
    assert model.weights.sum(axis=1) == pytest.approx(np.ones(80))
    assert model.landmarks[WRIST_LANDMARK] == pytest.approx(np.zeros(3))
    assert model.landmarks[11] == pytest.approx([0.08, 0.0016, 0.0]), "the middle finger begins 8 cm from the wrist"
    assert np.linalg.norm(model.joint_axes, axis=1) == pytest.approx(np.ones(umetrack.N_JOINTS))


def test_no_angle_is_zero(model) -> None:
    """The dataset's own toolkit divides by an angle's size."""
    assert (finger_angles(np.linspace(0.0, 1.0, 5))[:, : umetrack.N_ANGLES] > 0.01).all()


def test_closing_the_hand_brings_the_finger_tips_towards_the_palm(model) -> None:
    bones = umetrack.bone_transforms(model, finger_angles(np.array([0.0, 1.0])))
    origin, upright = np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1))
    tips = umetrack.pose_points(model.landmarks, model.landmark_weights, bones, origin, upright, mirrored=False)[:, 1:5]
    palm = model.landmarks[PALM_LANDMARK]
    opened, closed = np.linalg.norm(tips - palm, axis=2)
    assert (closed < opened - 0.01).all()


@pytest.mark.parametrize("side", [0, 1])
def test_the_hand_lies_along_the_performance_s_hand(model, side) -> None:
    """With the arm hanging the segment's y axis points down and its x axis left; thumbs then point forward."""
    segment = Rotation.from_matrix(np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]))
    rotation = wrist_rotation(segment, side).as_quat(scalar_first=True)[None]
    bones = umetrack.bone_transforms(model, np.zeros((1, umetrack.N_JOINTS)))
    landmarks = umetrack.pose_points(
        model.landmarks, model.landmark_weights, bones, np.zeros((1, 3)), rotation, mirrored=side == 1
    )[0]
    middle_base, thumb, palm = landmarks[11], landmarks[6], landmarks[PALM_LANDMARK]
    assert middle_base[1] == pytest.approx(-0.08), "down"
    assert thumb[2] > 0.01, "forward"
    assert palm[0] * (1.0 if side == 0 else -1.0) < 0, "towards the body: left is +x"
