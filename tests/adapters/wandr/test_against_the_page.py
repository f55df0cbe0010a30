"""What golden values do not hold: our network and roll-outs beside NumPy written from the page."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.kinematics import rest_offsets
from prbench_adapters.wandr.adapter import Start, roll_out
from prbench_adapters.wandr.network import BodyState, WandrNetwork, heading_of, intentions, yaw_rotation
from tests.adapters.wandr import page, tiny
from tests.fakes import smooth_motion

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
