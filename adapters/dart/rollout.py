"""Primitive after primitive: each begins with the last frames of the one before, seen from the first of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from prbench_adapters.dart.configuration import HISTORY_FRAMES
from prbench_adapters.dart.frames import Frames, Placement
from prbench_adapters.dart.model import DartModel

SampleLatent = Callable[[int, Float[Tensor, "batch history 276"]], Float[Tensor, "batch 1 latent"]]
"""Maps number and standardised history of a primitive to its clean latent, divided by the latents' std."""


@dataclass(frozen=True)
class Primitive:
    """One primitive of B motions."""

    history: Float[Tensor, "batch history 276"]
    """Standardised, in the primitive's frame of reference."""
    latent: Float[Tensor, "batch 1 latent"]
    """Divided by the latents' std."""
    features: Float[Tensor, "batch future 276"]
    """Standardised, likewise."""
    placement: Placement
    """Placement of its frame of reference in the world."""
    joints: Float[Tensor, "batch future 22 3"]
    """Joints of the future frames, in the world, metres."""


def first_history(
    previous: Float[Tensor, "batch 22 3"], initial: Float[Tensor, "batch 22 3"]
) -> tuple[Frames, Placement]:
    """The history that a motion starts from: the frame before it and its first, in the world with Z up, metres.

    What leads on from the first frame is not known; the body is taken to go on as it came.
    """
    frames = Frames.of_joints(torch.stack((previous, initial, initial), dim=1))
    came = {
        name: getattr(frames, name)[:, :1].expand_as(getattr(frames, name))
        for name in ("translation_delta", "orientation_delta", "joints_delta")
    }
    return replace(frames, **came).canonical()


def roll_out(
    model: DartModel,
    history: Float[Tensor, "batch history 276"],
    placement: Placement,
    sample: SampleLatent,
    primitives: int,
    *,
    going_on: Sequence[int] | None = None,
    checkpointing: bool = False,
) -> list[Primitive]:
    """Generate primitives; differentiable from the latents' noise to the last joint.

    Args:
        model: The frozen model.
        history: Standardised, of the first primitive (:func:`first_history`).
        placement: Of its frame of reference in the world.
        sample: Makes the latents.
        primitives: How many.
        going_on: How many motions, the first ones, have each primitive; None if all have all. What motions are to be
            shorter come last, and cost nothing behind their end.
        checkpointing: Keep nothing but histories for the backward pass and compute each primitive once more there.
    """
    done: list[Primitive] = []
    for number in range(primitives):
        if going_on is not None:
            # Sequences that have ended cost nothing more.
            history = history[: going_on[number]]
            placement = placement.first(going_on[number])
        if checkpointing and torch.is_grad_enabled():
            latent, features = checkpoint(_generate, model, sample, number, history, use_reentrant=False)
        else:
            latent, features = _generate(model, sample, number, history)
        future = model.scaling.frames(features)
        done.append(Primitive(history, latent, features, placement, placement.points(future.joints)))
        # Each primitive starts in a frame of reference of its own, as the networks have learnt it.
        frames, inner = next_history(future)
        history = model.scaling.standardised(frames)
        placement = placement.then(inner)
    return done


def next_history(future: Frames) -> tuple[Frames, Placement]:
    """The last frames of a primitive as the history of the next, and where its frame of reference stands in this one.

    That frame of reference is taken from the predicted joints.
    """
    n = future.joints.shape[1]
    return future.part(n - HISTORY_FRAMES, n).canonical()


def _generate(
    model: DartModel, sample: SampleLatent, number: int, history: Tensor
) -> tuple[Float[Tensor, "batch 1 latent"], Float[Tensor, "batch future 276"]]:
    latent = sample(number, history)
    return latent, model.vae.decode(latent * model.latent_std, history)
