"""Joints from body models, on invented models that have the keys of the real ones."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import nn

from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bodies import joints_from_parameters, read_pose_decoder, read_rest_joints
from tests.fakes import STANDING
from tests.readers import gimo_sample as sample

RNG = np.random.default_rng(5)


class Decoder(nn.Module):
    """The network that the real file holds the weights of, with other sizes inside."""

    def __init__(self, width: int = 24) -> None:
        super().__init__()
        self.bodyprior_enc_fc1 = nn.Linear(63, width)
        self.bodyprior_dec_fc1 = nn.Linear(32, width)
        self.bodyprior_dec_fc2 = nn.Linear(width, width)
        self.bodyprior_dec_out = nn.Linear(width, 126)

    def forward(self, latent: torch.Tensor) -> torch.Tensor:
        hidden = nn.functional.leaky_relu(self.bodyprior_dec_fc1(latent), negative_slope=0.2)
        hidden = nn.functional.leaky_relu(self.bodyprior_dec_fc2(hidden), negative_slope=0.2)
        columns = self.bodyprior_dec_out(hidden).view(-1, 3, 2)
        first = nn.functional.normalize(columns[:, :, 0], dim=1)
        along = (first * columns[:, :, 1]).sum(dim=1, keepdim=True)
        second = nn.functional.normalize(columns[:, :, 1] - along * first, dim=-1)
        third = torch.cross(first, second, dim=1)
        return torch.stack([first, second, third], dim=-1).view(-1, 21, 3, 3)


@pytest.fixture(scope="module")
def network() -> Decoder:
    torch.manual_seed(3)
    return Decoder()


@pytest.fixture(scope="module")
def vposer(network, tmp_path_factory):
    path = tmp_path_factory.mktemp("vposer") / "TR00_E096.pt"
    torch.save(network.state_dict(), path)
    return path


@pytest.fixture(scope="module")
def smplx(tmp_path_factory):
    """A body of a closed sheet of vertices; each joint is the mean of a few of them."""
    n = 40
    template = RNG.uniform(-0.5, 0.5, (n, 3))
    regressor = np.zeros((55, n))
    for joint in range(55):
        regressor[joint, RNG.choice(n, 4, replace=False)] = 0.25
    faces = np.array([[i, (i + 1) % n, (i + 7) % n] for i in range(n)], dtype=np.uint32)
    path = tmp_path_factory.mktemp("smplx") / "SMPLX_NEUTRAL.npz"
    np.savez(
        path,
        v_template=template,
        J_regressor=regressor,
        f=faces,
        joint2num=np.array({"Pelvis": 0}, dtype=object),  # the real file holds Python objects, too
    )
    return path


def test_route_a_follows_the_network_and_the_kinematic_tree(network, vposer, smplx) -> None:
    n = 3
    poses = gimo.SmplxPoses(
        np.arange(n),
        RNG.normal(size=(n, 3)).astype(np.float32),
        RNG.normal(size=(n, 3)).astype(np.float32),
        RNG.normal(size=(n, 32)).astype(np.float32),
    )
    rest = read_rest_joints(smplx)
    found = joints_from_parameters(poses, read_pose_decoder(vposer), rest)
    with torch.no_grad():
        local = network.double()(torch.tensor(poses.latent, dtype=torch.float64)).numpy()
    with np.load(smplx) as arrays:
        np.testing.assert_allclose(rest, arrays["J_regressor"][:23] @ arrays["v_template"], atol=1e-12)
    for frame in range(n):  # an independent walk down the tree with matrices
        world = [np.eye(4)] * N_JOINTS
        for joint, parent in enumerate(PARENTS):
            step = np.eye(4)
            root = Rotation.from_rotvec(poses.orient[frame].astype(np.float64)).as_matrix()
            step[:3, :3] = root if parent < 0 else local[frame, joint - 1]
            step[:3, 3] = rest[joint] - (0 if parent < 0 else rest[parent])
            world[joint] = step if parent < 0 else world[parent] @ step
            expected = world[joint][:3, 3] + poses.trans[frame]
            np.testing.assert_allclose(found.joints[frame, joint], expected, atol=1e-9)
        assert found.jaw is not None
        offset = rest[N_JOINTS] - rest[Joint.HEAD]
        jaw = (world[Joint.HEAD] @ [*offset, 1.0])[:3] + poses.trans[frame]
        np.testing.assert_allclose(found.jaw[frame], jaw, atol=1e-9)


def test_moving_the_body_moves_trans_by_more_than_the_rotation_of_trans(vposer, smplx) -> None:
    """The exact chain: trans_c = R (trans + J0) + t - J0; rotating trans alone is off by up to |J0|."""
    decoder, rest = read_pose_decoder(vposer), read_rest_joints(smplx)
    turn, shift = Rotation.from_rotvec([0.0, 1.2, 0.0]), np.array([0.5, 0.0, -0.3])
    orient, trans, latent = np.array([[0.1, 0.2, 0.3]]), np.array([[1.0, 0.9, 2.0]]), RNG.normal(size=(1, 32))
    j0 = rest[0]

    def joints(rotation: Rotation, translation: np.ndarray) -> np.ndarray:
        poses = gimo.SmplxPoses(np.array([0]), rotation.as_rotvec()[None], translation, latent)
        return joints_from_parameters(poses, decoder, rest).joints

    moved = turn.apply(joints(Rotation.from_rotvec(orient[0]), trans)[0]) + shift
    exact = joints(turn * Rotation.from_rotvec(orient[0]), turn.apply(trans + j0) + shift - j0)[0]
    np.testing.assert_allclose(exact, moved, atol=1e-9)
    careless = joints(turn * Rotation.from_rotvec(orient[0]), turn.apply(trans) + shift)[0]
    assert np.abs(careless - moved).max() > 0.01


def test_a_prefix_before_the_weights_is_understood(network, tmp_path) -> None:
    path = tmp_path / "a.pt"
    torch.save({"state_dict": {f"vp_model.{k}": v for k, v in network.state_dict().items()}}, path)
    assert read_pose_decoder(path).weights[0].shape == (24, 32)


def test_the_reader_prefers_parameters_to_the_suit(tmp_path, vposer, smplx) -> None:
    root = sample.write_root(tmp_path / "GIMO", sample.readings())
    both = sample.read_back(root, vposer_model=vposer, smplx_model=smplx).body
    assert isinstance(both, gimo.LocalJoints)
    assert isinstance(sample.read_back(root, smplx_model=smplx).body, gimo.LocalSkeleton)
    suit = sample.read_back(root, vposer_model=vposer, smplx_model=smplx, body="bvh").body
    assert isinstance(suit, gimo.LocalSkeleton)
    assert isinstance(sample.read_back(root).body, gimo.LocalSkeleton)


def test_the_rest_pelvis_without_a_model_is_that_of_the_page() -> None:
    poses = sample.readings().body.poses  # type: ignore[union-attr]
    np.testing.assert_allclose(poses.pelvis() - poses.trans, np.tile((0.0031, -0.3514, 0.0120), (45, 1)), atol=1e-6)
    assert STANDING.shape == (22, 3)
