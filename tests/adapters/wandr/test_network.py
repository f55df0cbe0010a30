"""States, intentions, network and roll-outs: laws, the original program, NumPy written from the page."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench_adapters.kinematics import WANDR, matrices_of, rest_offsets, rows_of
from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.wandr.adapter import Start, roll_out
from prbench_adapters.wandr.network import (
    CONDITION_SIZE,
    DELTA_SIZE,
    SEEN_SIZE,
    BodyState,
    WandrConfiguration,
    WandrNetwork,
    clean_delta,
    heading_of,
    hidden_widths,
    intentions,
    yaw_rotation,
)
from tests.adapters.wandr import page, tiny
from tests.fakes import smooth_motion

JOINTS = WANDR.from_y_up(torch.tensor(smooth_motion("wandr", 12, amplitude=0.5)).double())
TURN = torch.tensor(Rotation.from_euler("z", 2.2).as_matrix())


def _turned(joints: torch.Tensor) -> torch.Tensor:
    return joints @ TURN.T + torch.tensor([3.0, -1.0, 0.0], dtype=torch.float64)


def test_a_change_leads_to_the_next_state():
    states = BodyState.fitted(JOINTS)
    following = states[:-1].changed(states[:-1].delta_to(states[1:]))
    assert torch.allclose(following.joints(rest_offsets(JOINTS[1:])), JOINTS[1:], atol=1e-9)


def test_neither_place_nor_yaw_reaches_the_network():
    states, turned = BodyState.fitted(JOINTS), BodyState.fitted(_turned(JOINTS))
    assert torch.allclose(turned.seen(), states.seen())
    assert torch.allclose(turned[:-1].delta_to(turned[1:]), states[:-1].delta_to(states[1:]))
    goal, left = JOINTS[-1:, 21], torch.full((12, 1), 10.0, dtype=torch.float64)

    def intended(joints, goal):
        yaw = yaw_rotation(BodyState.fitted(joints).rotations[:, 0])
        return intentions(
            yaw, wrist=joints[:, 21], pelvis=joints[:, 0], goal=goal.expand(12, 3), frames_left=left, fps=30.0
        )

    assert torch.allclose(intended(_turned(JOINTS), _turned(goal)), intended(JOINTS, goal))


def test_any_prediction_gives_a_rotation():
    state = BodyState.fitted(JOINTS)
    delta = torch.randn(12, 135, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    changed = state.changed(delta)
    assert torch.allclose(changed.rotations @ changed.rotations.mT, torch.eye(3).double(), atol=1e-9)
    assert torch.allclose(state.delta_to(changed), clean_delta(delta))


@pytest.mark.parametrize("lean", [0, 50, 90, 120])
def test_bodies_that_bend_forward_keep_their_yaw(lean):
    root = Rotation.from_euler("z", 40, degrees=True) * Rotation.from_euler("x", 90 + lean, degrees=True)
    yaw = yaw_rotation(torch.tensor(root.as_matrix()))
    assert torch.allclose(yaw, torch.tensor(Rotation.from_euler("z", 40, degrees=True).as_matrix()), atol=1e-9)


def test_bodies_on_their_side_head_where_they_face():
    root = torch.tensor([[0.0, 0.6, 0.8], [0.0, -0.8, 0.6], [1.0, 0.0, 0.0]])  # left up, front to (0.8, 0.6)
    assert torch.allclose(heading_of(yaw_rotation(root)), torch.tensor([0.8, 0.6, 0.0]))


def test_layers_of_the_original():
    assert (SEEN_SIZE, DELTA_SIZE, CONDITION_SIZE) == (133, 135, 277)
    assert hidden_widths(412, 128, 14, 512) == [512] * 7 + [256] * 6
    assert hidden_widths(341, 135, 14, 512) == [512] * 5 + [256] * 8
    count = sum(parameter.numel() for parameter in WandrNetwork(WandrConfiguration()).parameters())
    assert count == pytest.approx(4.15e6, rel=2e-3)


@pytest.mark.parametrize("bad", [{"layers": 0}, {"dropout": 1.0}, {"fps": 0.0}, {"latent": 0}])
def test_impossible_sizes_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        WandrConfiguration(**bad)


TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def golden(samples) -> dict[str, torch.Tensor]:
    with np.load(samples / "metrics" / "networks" / "wandr_step.npz") as arrays:
        return {name: torch.from_numpy(arrays[name]) for name in arrays}


def test_yaw_intentions_and_next_state_are_those_of_the_original(golden):
    root = matrices_of(golden["root6d"])
    yaw = yaw_rotation(root)
    given = {name: golden[name] for name in ("wrist", "pelvis", "goal", "frames_left")}
    wrist, pelvis, heading = intentions(yaw, **given, fps=30.0).split(3, -1)
    state = BodyState(golden["translation"], matrices_of(golden["rotations6d"]))
    following = state.changed(torch.cat((golden["delta_translation"], golden["delta_rotations6d"].flatten(1)), -1))
    recovered = state.delta_to(BodyState(golden["next_translation"], matrices_of(golden["next_rotations6d"])))
    for name, found in {
        "yaw_rotation": yaw,
        "heading": heading_of(yaw),
        "orientation_without_yaw": rows_of(yaw.mT @ root),
        "wrist_intention": wrist,
        "pelvis_intention": pelvis,
        "heading_intention": heading,
        "next_translation": following.pelvis,
        "next_rotations6d": rows_of(following.rotations),
        "delta_translation": recovered[:, :3],
        "delta_from_pair": recovered[:, 3:].unflatten(1, golden["delta_from_pair"].shape[1:]),
    }.items():
        error = (found - golden[name]).abs() / golden[name].abs().clamp_min(1.0)
        assert error.max() < TOLERANCE, f"{name}: {error.max():.1e}"


@pytest.mark.parametrize(
    ("wrist", "pelvis", "goal", "expected"),
    [
        ([0.3, -0.2, 1], [0, 0, 0.9], [1.3, -1.2, 1], [0.99999, -0.99999, 0, 1.2178, -1.1242, 0, 0.7348, 0.3217, 0]),
        ([0, 0, 1], [0, 0, 1], [0, 0, 2], [0, 0, 1, 0, 0, 0, 0, 0, 0]),
    ],
    ids=["the page's example", "straight above nothing is said about the heading"],
)
def test_intentions_by_hand(wrist, pelvis, goal, expected):
    given = {"wrist": wrist, "pelvis": pelvis, "goal": goal, "frames_left": [30.0]}
    tensors = {name: torch.tensor([values], dtype=torch.float32) for name, values in given.items()}
    found = intentions(torch.eye(3)[None], **tensors, fps=30.0)
    assert found[0].tolist() == pytest.approx(expected, abs=1e-4)


N_FRAMES = (9, 14, 2)
GOALS = torch.tensor([[1.2, -2.0, 1.1], [-0.4, 0.3, 0.8], [3.0, 0.1, 1.6]], dtype=torch.float64)


def _start() -> Start:
    """Three people in the course of bending and turning, with bones of their own."""
    motions = [
        WORLD.from_y_up(torch.tensor(smooth_motion(f"person {i}", 2, amplitude=0.4)).double()) * (0.8 + 0.2 * i)
        for i in range(3)
    ]
    before, state = (BodyState.fitted(torch.stack([motion[frame] for motion in motions])) for frame in (0, 1))
    offsets = rest_offsets(torch.stack([motion[1] for motion in motions]))
    return Start(state, before.delta_to(state), offsets, GOALS, torch.tensor(N_FRAMES))


def _body(state: BodyState, row: int) -> page.Body:
    return page.Body(state.pelvis[row].numpy(), state.rotations[row].numpy())


def _normal(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(6), dtype=torch.float64)


@pytest.mark.parametrize(
    ("layers", "widest", "latent", "fps"), [(3, 32, 8, 30.0), (14, 64, 64, 30.0), (5, 512, 3, 12.0)]
)
def test_roll_outs_of_other_lengths_sizes_and_rates(layers, widest, latent, fps):
    network = tiny.network(seed=layers, layers=layers, widest=widest, latent=latent, fps=fps).double()
    network.delta.mean[3:] += 0.01 * _normal(132)  # what is decoded is no rotation yet
    start, noise = _start(), _normal(3, max(N_FRAMES) - 1, latent)
    found = roll_out(network, start, noise)
    for row, n_frames in enumerate(N_FRAMES):
        expected = page.roll_out(
            _body(start.state, row),
            start.delta[row].numpy(),
            start.offsets[row].numpy(),
            GOALS[row].numpy(),
            noise[row, : n_frames - 1].numpy(),
            page.values_of(network),
            layers=layers,
            fps=fps,
        )
        assert np.linalg.norm(expected[-1, 0] - expected[0, 0]) > 1e-3  # it goes somewhere
        np.testing.assert_allclose(found[row, :n_frames].numpy(), expected, atol=1e-7)


@pytest.mark.parametrize("original_deviation", [False, True])
def test_what_the_autoencoder_makes_of_a_change(original_deviation):
    network: WandrNetwork = tiny.network(layers=4, original_deviation=original_deviation).double()
    start, noise, values = _start(), _normal(3, 8), page.values_of(network)
    intended = _normal(3, 9)
    known = network.condition(start.state.seen(), start.delta, intended)
    mean, log_variance = network.encode(network.delta(start.delta), known)
    decoded = network.decode(network.draw(mean, log_variance, noise), known)
    for row in range(3):
        told = page.condition(_body(start.state, row), start.delta[row].numpy(), intended[row].numpy(), values)
        change = page.standardised(start.delta[row].numpy(), values, "delta")
        drawn_from = page.stack(np.concatenate([change, told]), values, "encoder", 4)
        spread = np.exp(drawn_from[8:] if original_deviation else 0.5 * drawn_from[8:])
        latent = drawn_from[:8] + noise[row].numpy() * spread
        expected = page.stack(np.concatenate([latent, told]), values, "decoder", 4)
        np.testing.assert_allclose(decoded[row].numpy(), expected, atol=1e-9)


def test_intentions_of_bodies_in_any_attitude():
    roots = torch.tensor(Rotation.random(200, random_state=3).as_matrix())
    upright_enough = roots[:, :2, 0].norm(dim=-1) > 0.1  # on their side the page's yaw means nothing
    roots = roots[upright_enough]
    n = len(roots)
    wrist, pelvis, goal, heading = _normal(4, n, 3)
    heading = heading / heading.norm(dim=-1, keepdim=True)
    left = torch.arange(1, n + 1).double()[:, None]
    given = {"wrist": wrist, "pelvis": pelvis, "goal": goal, "frames_left": left, "fps": 30.0}
    yaw = yaw_rotation(roots)
    towards_goal, as_recorded = intentions(yaw, **given), intentions(yaw, **given, goal_heading=heading)
    for row in range(n):
        body = page.Body(pelvis[row].numpy(), roots[row : row + 1].numpy())
        joints = np.zeros((22, 3))
        joints[page.PELVIS], joints[page.RIGHT_WRIST] = pelvis[row].numpy(), wrist[row].numpy()
        told = (body, joints, goal[row].numpy(), row + 1, 30.0)
        np.testing.assert_allclose(towards_goal[row].numpy(), page.intention(*told), atol=1e-9)
        np.testing.assert_allclose(
            as_recorded[row].numpy(), page.intention(*told, goal_heading=heading[row].numpy()), atol=1e-9
        )
        np.testing.assert_allclose(heading_of(yaw)[row].numpy(), -page.yaw_of(body.rotations[0])[:, 1], atol=1e-9)
