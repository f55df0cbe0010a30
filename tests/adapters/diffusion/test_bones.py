"""Motions on the skeleton of their first pose."""

from __future__ import annotations

import numpy as np
import torch

from prbench.skeleton import BONES, Joint
from prbench_adapters.diffusion.bones import bone_lengths, with_bone_lengths
from tests.fakes import STANDING, smooth_motion

WOBBLING = torch.as_tensor(np.stack([smooth_motion(name, 20) for name in "ab"]))
LENGTHS = bone_lengths(torch.as_tensor(np.stack([STANDING, STANDING * 1.1]), dtype=torch.float32))


def test_the_lengths_are_those_asked_for_in_every_frame():
    found = bone_lengths(with_bone_lengths(WOBBLING, LENGTHS))
    assert torch.allclose(found, LENGTHS[:, None].expand_as(found), atol=1e-6)


def test_directions_and_pelvis_stay():
    relaid = with_bone_lengths(WOBBLING, LENGTHS)
    assert torch.equal(relaid[:, :, Joint.PELVIS], WOBBLING[:, :, Joint.PELVIS])
    parents, children = np.transpose(BONES)
    before, after = (motion[:, :, children] - motion[:, :, parents] for motion in (WOBBLING, relaid))
    cosine = torch.nn.functional.cosine_similarity(before, after, dim=-1)
    assert torch.allclose(cosine, torch.ones_like(cosine), atol=1e-5)


def test_a_motion_that_has_these_lengths_already_stays_as_it_is():
    relaid = with_bone_lengths(WOBBLING, LENGTHS)
    assert torch.allclose(with_bone_lengths(relaid, LENGTHS), relaid, atol=1e-6)


def test_gradients_reach_every_joint_and_are_finite_for_a_vanished_bone():
    joints = WOBBLING.clone()
    joints[0, 3, Joint.HEAD] = joints[0, 3, Joint.NECK]
    joints.requires_grad_()
    with_bone_lengths(joints, LENGTHS)[:, :, Joint.RIGHT_WRIST].square().sum().backward()
    assert joints.grad is not None
    assert torch.isfinite(joints.grad).all()
    moving = joints.grad.abs().amax(dim=(0, 1, 3)) > 0
    assert moving[Joint.RIGHT_ELBOW]
    assert moving[Joint.PELVIS]
    assert not moving[Joint.LEFT_WRIST]
