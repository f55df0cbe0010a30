"""Turned and mirrored bodies stay bodies, and their gaze goes with them."""

from __future__ import annotations

import math

import pytest
import torch

from prbench.geometry.skeleton import BONES, Joint
from prbench_adapters.prediction.training import augmented, mirror_partners

NAMES = [joint.name.lower() for joint in Joint]
STILL, NEVER = torch.zeros(2), torch.zeros(2, dtype=torch.bool)


@pytest.fixture
def motion():
    return torch.randn(2, 7, 23, 3, generator=torch.Generator().manual_seed(1))


def test_partners_are_found_by_either_spelling():
    partners = mirror_partners(NAMES)
    assert partners[Joint.LEFT_WRIST] == Joint.RIGHT_WRIST
    assert partners[Joint.HEAD] == Joint.HEAD
    assert [partners[partner] for partner in partners] == list(range(22))
    assert mirror_partners(["base", "lHip", "linnerShoulder", "rHip", "rinnerShoulder"]) == (0, 3, 4, 1, 2)
    with pytest.raises(ValueError, match="'left_eye' has no partner"):
        mirror_partners(["head", "left_eye"])


def test_a_mirror_exchanges_left_and_right(motion):
    found = augmented(motion, mirror_partners(NAMES), turn=STILL, mirrored=torch.tensor([True, False]))
    assert torch.equal(found[1], motion[1])
    expected = motion[0, :, Joint.RIGHT_WRIST] * torch.tensor([-1.0, 1.0, 1.0])
    assert torch.equal(found[0, :, Joint.LEFT_WRIST], expected)
    assert torch.equal(found[0, :, 22, 0], -motion[0, :, 22, 0])


def test_a_turn_is_about_the_vertical_and_keeps_bones(motion):
    turn = torch.tensor([math.pi / 2, 0.3])
    found = augmented(motion, mirror_partners(NAMES), turn=turn, mirrored=NEVER)
    torch.testing.assert_close(found[0, ..., 0], motion[0, ..., 2])
    assert torch.equal(found[..., 1], motion[..., 1])
    parents, children = map(list, zip(*BONES))
    torch.testing.assert_close(
        (found[:, :, parents] - found[:, :, children]).norm(dim=-1),
        (motion[:, :, parents] - motion[:, :, children]).norm(dim=-1),
    )
    torch.testing.assert_close(found[:, :, 22].norm(dim=-1), motion[:, :, 22].norm(dim=-1))
