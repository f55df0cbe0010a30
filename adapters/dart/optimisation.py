"""The noise of all primitives of a motion, moved together until its last frame meets the goal.

Source: docs/specification/dart.md#noise-optimisation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn import functional

from prbench.geometry.skeleton import Joint
from prbench_adapters.dart.configuration import DartSettings, GradientNorm
from prbench_adapters.diffusion.noise_optimisation.objective import (
    Targets,
    chosen_wrist,
    largest_jerk,
    last_frame,
)

Noise = Float[Tensor, "primitives batch 1 latent"]
Joints = Float[Tensor, "batch frames 22 3"]

_SHORTEST_GRADIENT = 1e-6
_FEET = (Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE, Joint.LEFT_FOOT, Joint.RIGHT_FOOT)


@dataclass(frozen=True)
class Optimised:
    """Result of an optimisation."""

    noise: Noise
    joints: Joints
    """Joints of the final noise."""
    losses: Float[Tensor, "iterations batch"]
    """Loss of each iterate before its step."""


def optimise(
    motion: Callable[[Noise], Joints],
    start: Noise,
    targets: Targets,
    n_frames: Int[Tensor, " batch"],
    settings: DartSettings,
) -> Optimised:
    """Lower the loss of every sequence by Adam on its noise.

    The gradient of each primitive has length 1, so that the learning rate says how far each moves; a primitive behind a
    sequence's end has no gradient and stays. With ``gradient_norm="sequence"`` no sequence notices the others.

    Args:
        motion: A differentiable map from noise to joints, metres, canonical frame; first frame first.
        start: The first noise.
        targets: Initial state and goal of each sequence, of which the goal is asked for.
        n_frames: Frames of each sequence; its last one is the goal's.
        settings: Iterations, learning rate and what else belongs to the loss.
    """
    noise = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([noise])
    losses = []
    for iteration in range(settings.iterations):
        for group in optimiser.param_groups:
            # Linear to 0: the last steps settle, the first ones search.
            group["lr"] = settings.learning_rate * (1.0 - iteration / settings.iterations)
        with torch.enable_grad():
            loss = goal_loss(motion(noise), n_frames, targets, settings)
            # Summed over sequences, none of which depends on another, so each gets its own gradient.
            (gradient,) = torch.autograd.grad(loss.sum(), noise)
        noise.grad = unit_gradient(gradient, settings.gradient_norm)
        optimiser.step()
        losses.append(loss.detach())
    with torch.no_grad():
        return Optimised(noise.detach(), motion(noise), torch.stack(losses))


def goal_loss(
    joints: Joints, n_frames: Int[Tensor, " batch"], targets: Targets, settings: DartSettings
) -> Float[Tensor, " batch"]:
    """Huber loss (δ = 1 m) of the last frame, averaged over the coordinates that are asked for.

    Asked for are all joints of a goal pose, or one wrist for a goal location. Jerk and floor join it if they weigh;
    both look at the whole motion, the frame before the first included.
    """
    last = last_frame(joints, n_frames)
    if targets.goal_joints is not None:
        error = last - targets.goal_joints
    else:
        assert targets.goal_location is not None
        error = (chosen_wrist(last, targets.goal_location, settings.hand) - targets.goal_location)[:, None]
    loss = functional.huber_loss(error, torch.zeros_like(error), reduction="none").mean(dim=(1, 2))
    if settings.jerk_weight or settings.floor_weight:
        whole = torch.cat((targets.previous_joints[:, None], joints), dim=1)
        loss = loss + settings.jerk_weight * largest_jerk(whole, n_frames + 1)
        loss = loss + settings.floor_weight * _depth_below_floor(whole, n_frames + 1)
    return loss


def _depth_below_floor(joints: Joints, n_frames: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, " batch"]:
    """Measure how far the lowest of ankles and toes is below that of frame 0, metres; mean over the frames."""
    lowest = joints[:, :, _FEET, 1].amin(dim=2)
    below = (lowest[:, :1] - lowest).clamp_min(0.0)
    inside = torch.arange(joints.shape[1], device=joints.device) < n_frames[:, None]
    return torch.where(inside, below, 0.0).sum(dim=1) / n_frames


def unit_gradient(gradient: Noise, norm: GradientNorm) -> Noise:
    """The gradient of each primitive at length 1: over its own latent in each sequence, or over all of the batch."""
    dimensions = (2, 3) if norm == "sequence" else (1, 2, 3)
    if norm == "batch":
        gradient = gradient / gradient.shape[1]  # the original's loss is the batch's mean, which its clamp can tell
    lengths = torch.linalg.vector_norm(gradient, dim=dimensions, keepdim=True)
    return gradient / lengths.clamp_min(_SHORTEST_GRADIENT)
