"""Losses by hand, and what padding may not do to them."""

from __future__ import annotations

import pytest
import torch

from prbench.skeleton import Joint
from prbench_adapters.diffusion.losses import Objective, losses


def _zeros(frames: int = 4, batch: int = 1) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    return torch.zeros(batch, frames, 263), torch.zeros(batch, frames, 22, 3), torch.zeros(batch, frames).bool()


def test_both_sums_share_one_divisor():
    features, joints, padding = _zeros()
    predicted, moved = features.clone(), joints.clone()
    predicted[0, 1, 7] = 3.0  # 9 in one of 4 x 263 entries
    moved[0, 2, 5] = torch.tensor([2.0, 0.0, 0.0])  # 4 square metres
    found = losses(Objective(), predicted, features, moved, joints, padding)
    assert float(found["features"]) == pytest.approx(9 / (263 * 4))
    assert float(found["joints"]) == pytest.approx(4 / (263 * 4))
    assert float(found["loss"]) == pytest.approx(13 / (263 * 4))


def test_weights_choose_the_parts():
    features, joints, padding = _zeros()
    moved = joints.clone()
    moved[0, 2, 5, 0] = 2.0  # the displacement errs by 2 m into this frame and by 2 m out of it
    found = losses(
        Objective(joint_loss_weight=0.0, velocity_loss_weight=10.0), features, features, moved, joints, padding
    )
    assert float(found["velocities"]) == pytest.approx(8 / (263 * 4))
    assert float(found["loss"]) == pytest.approx(80 / (263 * 4))


def test_a_body_moved_as_a_whole_has_no_bone_loss_and_a_stretched_one_has():
    features, joints, padding = _zeros()
    stretched = joints.clone()
    stretched[0, 2, Joint.RIGHT_WRIST, 1] = 0.5  # one bone, half a metre too long, in one of four frames
    weights = Objective(joint_loss_weight=0.0, bone_loss_weight=2.0)
    assert float(losses(weights, features, features, joints + 1.0, joints, padding)["loss"]) == pytest.approx(0.0)
    found = losses(weights, features, features, stretched, joints, padding)
    assert float(found["bones"]) == pytest.approx(0.25 / (263 * 4))
    assert float(found["loss"]) == pytest.approx(0.5 / (263 * 4))


def test_whatever_stands_in_padding_leaves_no_trace():
    features, joints, padding = _zeros(6)
    padding[:, 4:] = True
    predicted = torch.full((1, 6, 263), 1.0)
    wild = predicted.clone()
    wild[:, 4:] = 1e6
    flying = joints.clone()
    flying[:, 4:] = 1e6
    plain = losses(Objective(velocity_loss_weight=1.0), predicted, features, joints, joints, padding)
    padded = losses(Objective(velocity_loss_weight=1.0), wild, features, flying, joints, padding)
    assert all(torch.equal(plain[name], padded[name]) for name in plain)
    assert float(plain["features"]) == pytest.approx(1.0)


def test_long_sequences_count_more_over_frames_but_not_over_sequences():
    features, joints, padding = _zeros(4, batch=2)
    padding[1, 1:] = True  # one frame against four
    predicted = features.clone()
    predicted[1, 0] = 1.0
    by_frames = losses(Objective(), predicted, features, joints, joints, padding)
    by_sequences = losses(Objective(loss_average="sequences"), predicted, features, joints, joints, padding)
    assert float(by_frames["features"]) == pytest.approx(1 / 5)
    assert float(by_sequences["features"]) == pytest.approx(1 / 2)
