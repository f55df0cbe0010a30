"""The torch side: equal to NumPy, indifferent to padding and batch mates, differentiable."""

from __future__ import annotations

import numpy as np
import torch

from prbench.representation import decode, encode, tensors
from tests.representation.motions import walk


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
