"""Joints from body models, on invented models that have the keys of the real ones."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import nn

from prbench.errors import InputFileError
from prbench.geometry.skeleton import N_JOINTS, PARENTS, Joint
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.bodies import (
    SmplxModel,
    joints_from_meshes,
    joints_from_parameters,
    read_obj,
    read_pose_decoder,
    read_smplx_model,
)
from tests.fakes import STANDING
from tests.readers import gimo_sample as sample

RNG = np.random.default_rng(5)
LIMITS = {"largest_edge_error": 0.002, "largest_spread": 1e-4}


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
    model = read_smplx_model(smplx)
    found = joints_from_parameters(poses, read_pose_decoder(vposer), model)
    with torch.no_grad():
        local = network.double()(torch.tensor(poses.latent, dtype=torch.float64)).numpy()
    rest = model.regressor @ model.template
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
        assert model.jaw_regressor is not None
        assert found.jaw is not None
        offset = model.jaw_regressor @ model.template - rest[Joint.HEAD]
        jaw = (world[Joint.HEAD] @ [*offset, 1.0])[:3] + poses.trans[frame]
        np.testing.assert_allclose(found.jaw[frame], jaw, atol=1e-9)


def test_moving_the_body_moves_trans_by_more_than_the_rotation_of_trans(vposer, smplx) -> None:
    """The exact chain: trans_c = R (trans + J0) + t - J0; rotating trans alone is off by up to |J0|."""
    decoder, model = read_pose_decoder(vposer), read_smplx_model(smplx)
    turn, shift = Rotation.from_rotvec([0.0, 1.2, 0.0]), np.array([0.5, 0.0, -0.3])
    orient, trans, latent = np.array([[0.1, 0.2, 0.3]]), np.array([[1.0, 0.9, 2.0]]), RNG.normal(size=(1, 32))
    j0 = model.rest_joints[0]

    def joints(rotation: Rotation, translation: np.ndarray) -> np.ndarray:
        poses = gimo.SmplxPoses(np.array([0]), rotation.as_rotvec()[None], translation, latent)
        return joints_from_parameters(poses, decoder, model).joints

    moved = turn.apply(joints(Rotation.from_rotvec(orient[0]), trans)[0]) + shift
    exact = joints(turn * Rotation.from_rotvec(orient[0]), turn.apply(trans + j0) + shift - j0)[0]
    np.testing.assert_allclose(exact, moved, atol=1e-9)
    careless = joints(turn * Rotation.from_rotvec(orient[0]), turn.apply(trans) + shift)[0]
    assert np.abs(careless - moved).max() > 0.01


def test_a_prefix_before_the_weights_is_understood(network, tmp_path) -> None:
    path = tmp_path / "a.pt"
    torch.save({"state_dict": {f"vp_model.{k}": v for k, v in network.state_dict().items()}}, path)
    assert read_pose_decoder(path).weights[0].shape == (24, 32)


@pytest.mark.parametrize("content", ["v2", "pickle", "nothing"])
def test_weights_of_something_else_are_refused(network, tmp_path, content) -> None:
    path = tmp_path / "a.pt"
    if content == "v2":
        torch.save({"decoder_net.0.weight": torch.zeros(3, 3)}, path)
    elif content == "pickle":
        path.write_bytes(pickle.dumps(print))
    says = {
        "v2": "expected the weights 'bodyprior_dec_fc1.weight'",
        "pickle": "a file of weights",
        "nothing": "no such",
    }
    with pytest.raises(InputFileError, match=says[content]):
        read_pose_decoder(path)


def test_a_model_without_an_array_is_refused(tmp_path) -> None:
    np.savez(tmp_path / "a.npz", v_template=np.zeros((3, 3)), f=np.zeros((1, 3)))
    with pytest.raises(InputFileError, match="expected an array 'J_regressor'"):
        read_smplx_model(tmp_path / "a.npz")
    (tmp_path / "b.pkl").write_bytes(pickle.dumps({"v_template": 1}))
    with pytest.raises(InputFileError, match=r"expected a readable \.npz file"):
        read_smplx_model(tmp_path / "b.pkl")


def write_mesh(path, vertices: np.ndarray, faces: np.ndarray, order: np.ndarray) -> None:
    """An OBJ file whose vertices stand in another order."""
    place = np.argsort(order)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices[order].tolist()]
    lines += ["f " + " ".join(f"{place[corner] + 1}/1/2" for corner in face) for face in faces]
    path.write_text("\n".join(["# exported", *lines]) + "\n")


@pytest.fixture
def meshes(smplx, tmp_path) -> tuple[dict[int, object], SmplxModel, np.ndarray]:
    """Two frames of the template, moved rigidly, shuffled differently."""
    model = read_smplx_model(smplx)
    files, moved = {}, []
    for frame in (9, 10):
        turned = Rotation.from_rotvec(RNG.normal(size=3)).apply(model.template) + RNG.normal(size=3)
        files[frame] = tmp_path / f"{frame}.obj"
        write_mesh(files[frame], turned, model.faces, RNG.permutation(len(turned)))
        moved.append(model.regressor @ turned)
    return files, model, np.array(moved)


def test_route_b_finds_shuffled_vertices_by_the_order_of_the_faces(meshes) -> None:
    files, model, expected = meshes
    found = joints_from_meshes(files, model, **LIMITS)
    assert found.frames.tolist() == [9, 10]
    np.testing.assert_allclose(found.joints, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        ("vertex", "expected 40 vertices, as the model has them, found 39"),
        ("face", "expected 40 faces, as the model has them, found 39"),
        ("order", "vertices on which faces disagree"),
        ("size", "edges as long as the model's, within 2 mm on average, found"),
        ("corner", "expected vertices from 1 to 40, found 99"),
        ("cut", "expected lines 'v x y z'"),
    ],
)
def test_a_mesh_of_something_else_is_refused(meshes, damage, says) -> None:
    files, model, _ = meshes
    path = files[10]
    vertices, faces = read_obj(path)
    lines = [f"v {x} {y} {z}" for x, y, z in vertices.tolist()]
    corners = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces.tolist()]
    if damage == "vertex":
        lines = lines[:-1]
    elif damage == "face":
        corners = corners[:-1]
    elif damage == "order":
        corners = corners[::-1]
    elif damage == "size":
        lines = [f"v {x} {y} {z}" for x, y, z in (vertices * 1.2).tolist()]
    elif damage == "corner":
        corners[0] = "f 1 2 99"
    else:
        lines[3] = "v 0.1 0.2"
    path.write_text("\n".join(lines + corners))
    with pytest.raises(InputFileError, match=says):
        joints_from_meshes(files, model, **LIMITS)


def test_the_reader_prefers_parameters_then_meshes_then_the_suit(tmp_path, vposer, smplx) -> None:
    root = sample.write_root(tmp_path / "GIMO", sample.readings())
    both = sample.read_back(root, vposer_model=vposer, smplx_model=smplx).body
    assert isinstance(both, gimo.LocalJoints)
    assert both.route == "smplx"
    assert isinstance(sample.read_back(root, smplx_model=smplx).body, gimo.LocalSkeleton), "there are no meshes"
    model = read_smplx_model(smplx)
    folder = root / "room1" / "2022-01-23-080759" / "smplx_local"
    for frame in range(100, 145):
        write_mesh(folder / f"{frame}.obj", model.template, model.faces, np.arange(40))
    mesh = sample.read_back(root, smplx_model=smplx).body
    assert isinstance(mesh, gimo.LocalJoints)
    assert mesh.route == "mesh"
    np.testing.assert_allclose(mesh.joints[7], model.rest_joints, atol=1e-12)
    assert isinstance(sample.read_back(root, smplx_model=smplx, body="bvh").body, gimo.LocalSkeleton)
    assert isinstance(sample.read_back(root).body, gimo.LocalSkeleton)


def test_the_rest_pelvis_without_a_model_is_that_of_the_page() -> None:
    poses = sample.readings().body.poses  # type: ignore[union-attr]
    np.testing.assert_allclose(poses.pelvis() - poses.trans, np.tile((0.0031, -0.3514, 0.0120), (45, 1)), atol=1e-6)
    assert STANDING.shape == (22, 3)
