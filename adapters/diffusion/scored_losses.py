"""Losses of what the benchmark looks at: where the head points, whether planted feet stay, where the wrists end.

Ours (docs/methods/pr.md): beside the features of a whole body these have so small a share of the study's loss that a
small network does not learn them. All are squared metres, averaged over frames.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from prbench.geometry.skeleton import TOES, WRISTS, Joint
from prbench_adapters.diffusion.goal_frame import head_axes, still_steps

Joints = Float[Tensor, "batch frames 22 3"]

_NEAREST = 0.3
_FARTHEST = 2.5
"""Metres: the goal's distance counts as at least and at most this, so that near and far goals are both learnt."""
_PRIMING_WIDTH = 0.75
"""Seconds around the prime time within which the head counts in full: most of the benchmark's window of one second."""
_OTHER_TIMES = 0.2
_ENDING = 0.3
"""Seconds before the end in which wrists count: the last part of a reach."""


def ray_loss(
    predicted: Joints,
    recorded: Joints,
    goal: Float[Tensor, "batch 3"],
    valid: Bool[Tensor, "batch frames"],
    prime: Float[Tensor, " frames"],
) -> Float[Tensor, ""]:
    """How far the head's axes miss the recorded ones at the distance of the goal.

    Args:
        predicted: Metres.
        recorded: Same frame.
        goal: Same frame.
        valid: False for padding.
        prime: Seconds of each frame after the prime time.
    """
    distance = (goal[:, None] - recorded[:, :, Joint.HEAD]).norm(dim=-1).clamp(_NEAREST, _FARTHEST)
    axes = zip(head_axes(predicted), head_axes(recorded), strict=True)
    missed = sum((ours - theirs).square().sum(dim=-1) for ours, theirs in axes) * distance.square()
    weight = (_OTHER_TIMES + torch.exp(-(prime / _PRIMING_WIDTH).square())) * valid
    return (missed * weight).sum() / weight.sum()


def foot_loss(
    predicted: Joints, recorded: Joints, valid: Bool[Tensor, "batch frames"], fps: float
) -> Float[Tensor, ""]:
    """Squared steps of the toes between frames in which the recorded ones are planted."""
    stays = still_steps(recorded, fps) & valid[:, 1:, None]
    slid = predicted[:, :, TOES].diff(dim=1).square().sum(dim=-1)
    return (slid * stays).sum() / stays.sum().clamp_min(1)


def wrist_loss(
    predicted: Joints,
    recorded: Joints,
    valid: Bool[Tensor, "batch frames"],
    n_frames: Int[Tensor, " batch"],
    fps: float,
) -> Float[Tensor, ""]:
    """Squared distance of the wrists from the recorded ones at the end of the reach."""
    frame = torch.arange(predicted.shape[1], device=predicted.device)
    ending = valid & (frame >= (n_frames[:, None] - _ENDING * fps))
    missed = (predicted - recorded)[:, :, WRISTS].square().sum(dim=-1).mean(dim=-1)
    return (missed * ending).sum() / ending.sum()
