"""The torch side: equal to NumPy, indifferent to padding and batch mates, differentiable."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.geometry.skeleton import PARENTS
from prbench.representation import REST_OFFSETS, Mode, decode, encode, tensors
from tests.fakes import STANDING
from tests.representation.motions import walk

LENGTHS = (40, 3, 17, 1)


def padded_batch(fill: float = 0.0) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Joints (4, 40, 22, 3) of several lengths, their lengths, and their next frames."""
    joints = torch.full((len(LENGTHS), max(LENGTHS), 22, 3), fill)
    after = torch.empty(len(LENGTHS), 22, 3)
    for i, n in enumerate(LENGTHS):
        motion = torch.from_numpy(walk(str(i), n + 1, turn=5.0))
        joints[i, :n], after[i] = motion[:-1], motion[-1]
    return joints, torch.tensor(LENGTHS), after


@pytest.mark.parametrize("mode", ["continuous", "reference"])
@pytest.mark.parametrize("fill", [0.0, 1e6, float("nan")])
def test_padded_rows_have_the_features_of_numpy_and_nothing_behind(mode: Mode, fill):
    joints, n_frames, after = padded_batch(fill)
    features = tensors.encode(joints, n_frames, next_joints=after, mode=mode).numpy()
    for i, n in enumerate(LENGTHS):
        alone = encode(joints[i, :n].numpy(), next_joints=after[i].numpy(), mode=mode)
        assert np.abs(features[i, :n] - alone).max() < 2e-5
        assert not features[i, n:].any()


def test_a_row_does_not_see_its_batch_mates():
    joints, n_frames, after = padded_batch()
    together = tensors.encode(joints, n_frames, next_joints=after)
    for i, n in enumerate(LENGTHS):
        alone = tensors.encode(joints[i : i + 1, :n], n_frames[i : i + 1], next_joints=after[i : i + 1])
        assert torch.allclose(together[i, :n], alone[0], atol=1e-6)


def test_without_a_next_frame_the_last_one_is_repeated():
    joints, n_frames, _ = padded_batch()
    last = joints[torch.arange(len(LENGTHS)), n_frames - 1]
    repeated = tensors.encode(joints, n_frames, next_joints=last)
    assert torch.equal(tensors.encode(joints, n_frames), repeated)


def test_joints_come_back_from_padded_features():
    joints, n_frames, after = padded_batch()
    features = tensors.encode(joints, n_frames, next_joints=after)
    recovered = tensors.decode(features)
    assert recovered.dtype == torch.float32
    for i, n in enumerate(LENGTHS):
        assert (recovered[i, :n] - joints[i, :n]).abs().max() < 2e-6


def test_decoding_is_that_of_numpy_for_any_leading_axes():
    features = torch.randn(2, 3, 60, 263, generator=torch.Generator().manual_seed(0)) * 0.1
    recovered = tensors.decode(features)
    assert np.abs(recovered.numpy() - decode(features.numpy())).max() < 2e-5
    assert torch.equal(recovered[1, 2], tensors.decode(features[1, 2]))


def test_padding_behind_a_motion_changes_neither_its_joints_nor_their_gradient():
    features = torch.randn(1, 20, 263, generator=torch.Generator().manual_seed(1)) * 0.1
    spoilt = torch.cat([features, torch.full((1, 5, 263), 1e3)], 1)
    gradients = []
    for rows in (features, spoilt):
        rows.requires_grad_()
        joints = tensors.decode(rows)[:, :20]
        joints.square().sum().backward()
        gradients.append((joints, rows.grad[:, :20]))
    assert torch.allclose(gradients[0][0], gradients[1][0])
    assert torch.allclose(gradients[0][1], gradients[1][1])
    assert not spoilt.grad[:, 20:].any()


def test_half_precision_is_summed_in_single():
    features = torch.from_numpy(encode(walk("half", 200)))[None].to(torch.bfloat16)
    assert torch.equal(tensors.decode(features), tensors.decode(features.float()))


def test_gradient_of_decoding_by_finite_differences():
    features = torch.randn(2, 5, 263, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) * 0.3
    assert torch.autograd.gradcheck(tensors.decode, features.requires_grad_(), fast_mode=True)


@pytest.mark.parametrize("mode", ["continuous", "reference"])
def test_gradient_of_encoding_by_finite_differences(mode: Mode):
    joints = torch.from_numpy(walk("gradient", 6)).double()[None]
    joints = torch.cat([joints[:, :4], joints[:, 1:5]])
    n_frames = torch.tensor([4, 2])
    after = joints[:, -1].clone() + 0.01

    def smooth_part(own: torch.Tensor, following: torch.Tensor) -> torch.Tensor:
        return tensors.encode(own, n_frames, next_joints=following, mode=mode)[..., :259]  # contacts are steps

    assert torch.autograd.gradcheck(
        smooth_part, (joints.requires_grad_(), after.requires_grad_()), fast_mode=True, eps=1e-7, atol=1e-5
    )


def test_degenerate_poses_have_finite_features_and_gradients():
    pose = torch.from_numpy(STANDING)
    coinciding = pose.clone()
    coinciding[10] = coinciding[7]  # a foot in its ankle
    coinciding[[16, 17]] = coinciding[[1, 2]]  # no heading
    opposite = pose * torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    joints = torch.stack([coinciding, opposite])[:, None].repeat(1, 3, 1, 1).requires_grad_()
    for mode in ("continuous", "reference"):
        features = tensors.encode(joints, torch.tensor([3, 2]), mode=mode)
        (gradient,) = torch.autograd.grad(features.sum(), joints)
        assert features.isfinite().all()
        assert gradient.isfinite().all()


def test_bones_opposite_to_their_rest_directions_turn_as_in_numpy():
    joints = np.repeat(STANDING[None], 3, axis=0)
    for joint in range(1, 22):
        joints[:, joint] = joints[:, PARENTS[joint]] - REST_OFFSETS[joint]
    features = tensors.encode(torch.from_numpy(joints)[None, :2], torch.tensor([2]))
    assert np.abs(features[0].numpy() - encode(joints, upright=False)).max() < 2e-5


def test_gradients_reach_the_motion_through_both_directions():
    """Encoding and decoding is the identity on canonical motions, and so is its derivative where frame 0 stays."""
    joints = torch.from_numpy(walk("identity", 8)).double()[None].requires_grad_()
    recovered = tensors.decode(tensors.encode(joints, torch.tensor([8])))
    weights = torch.randn(recovered[:, 1:].shape, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    (gradient,) = torch.autograd.grad((recovered[:, 1:] * weights).sum(), joints)
    assert torch.allclose(gradient[:, 1:], weights, atol=1e-9)
