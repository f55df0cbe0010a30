"""States and changes obey their laws; the network has the layers of the original."""

from __future__ import annotations

import pytest
import torch
from scipy.spatial.transform import Rotation

from prbench_adapters.kinematics import WANDR, rest_offsets
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


def test_a_goal_straight_above_the_pelvis_says_nothing_about_the_heading():
    standing = torch.tensor([[0.0, 0.0, 1.0]])
    found = intentions(
        torch.eye(3)[None],
        wrist=standing,
        pelvis=standing,
        goal=torch.tensor([[0.0, 0.0, 2.0]]),
        frames_left=torch.tensor([[30.0]]),
        fps=30.0,
    )
    assert found[0].tolist() == pytest.approx([0, 0, 1, 0, 0, 0, 0, 0, 0], abs=1e-4)


def test_layers_of_the_original():
    assert (SEEN_SIZE, DELTA_SIZE, CONDITION_SIZE) == (133, 135, 277)
    assert hidden_widths(412, 128, 14, 512) == [512] * 7 + [256] * 6
    assert hidden_widths(341, 135, 14, 512) == [512] * 5 + [256] * 8
    count = sum(parameter.numel() for parameter in WandrNetwork(WandrConfiguration()).parameters())
    assert count == pytest.approx(4.15e6, rel=2e-3)


def test_what_the_deviation_of_a_latent_is():
    mean, log_variance, noise = torch.zeros(1, 64), torch.full((1, 64), 2.0), torch.ones(1, 64)
    ours = WandrNetwork(WandrConfiguration()).draw(mean, log_variance, noise)
    original = WandrNetwork(WandrConfiguration(original_deviation=True)).draw(mean, log_variance, noise)
    assert torch.allclose(ours, torch.e * noise)
    assert torch.allclose(original, torch.e**2 * noise)


@pytest.mark.parametrize("bad", [{"layers": 0}, {"dropout": 1.0}, {"fps": 0.0}, {"latent": 0}])
def test_impossible_sizes_are_refused(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        WandrConfiguration(**bad)
