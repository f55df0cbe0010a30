from __future__ import annotations

import pytest
import torch

from prbench.workflows.text_to_motion.losses import (
    EvaluatorObjective,
    contrastive_losses,
    different_texts,
    reconstruction_losses,
)


def test_contrast_worked_by_hand():
    """Own motions 3 and 0 away; the other's 4 and 12 away, of a margin of 10."""
    text = torch.tensor([[0.0, 0.0], [12.0, 0.0]])
    motion = torch.tensor([[0.0, 3.0], [12.0, 0.0]])
    motion_of_other = motion.roll(1, dims=0)
    assert motion_of_other.tolist() == [[12.0, 0.0], [0.0, 3.0]]
    far = [12.0, (144 + 9) ** 0.5]
    losses = contrastive_losses(text, motion, shift=1, margin=15.0)
    assert losses["positive"].item() == pytest.approx(9 / 2, abs=1e-4)
    assert losses["negative"].item() == pytest.approx(sum((15 - d) ** 2 for d in far) / 2, abs=1e-3)
    assert losses["loss"].item() == pytest.approx(losses["positive"].item() + losses["negative"].item())
    assert losses["ranked"].item() == 1.0
    assert contrastive_losses(text, motion, shift=1, margin=10.0)["negative"].item() == 0.0


def test_rows_with_equal_texts_can_be_left_out_of_the_negatives():
    text, motion = torch.zeros(3, 2), torch.tensor([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    counted = different_texts(["a", "b", "a"], 1)  # row 0 meets the motion of row 2
    assert counted.tolist() == [False, True, True]
    negative = contrastive_losses(text, motion, shift=1, margin=10.0, counted=counted)["negative"]
    assert negative.item() == pytest.approx((9**2 + 8**2) / 2, abs=1e-3)


def test_reconstruction_counts_valid_frames_only():
    recorded, reconstructed = torch.zeros(2, 8, 259), torch.ones(2, 8, 259)
    reconstructed[1, 4:] = 100.0
    losses = reconstruction_losses(
        EvaluatorObjective(), recorded, reconstructed, torch.zeros(2, 2, 3), torch.tensor([8, 4])
    )
    assert losses["reconstruction"].item() == pytest.approx(1.0)
    assert losses["loss"].item() == pytest.approx(1.0)


def test_snippets_pay_for_their_size_and_for_changes():
    nothing, snippets = torch.zeros(1, 8, 259), torch.tensor([[[1.0, -1.0], [3.0, 1.0]]])
    loss = reconstruction_losses(EvaluatorObjective(), nothing, nothing, snippets, torch.tensor([8]))["loss"]
    assert loss.item() == pytest.approx(0.001 * (6 / 4) + 0.001 * 2.0)
