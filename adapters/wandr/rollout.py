"""Frame after frame from a first state: intentions, a draw, a change (docs/specification/wandr.md#inference)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int

from prbench.skeleton import Joint
from prbench_adapters.wandr.intentions import intentions
from prbench_adapters.wandr.network import WandrNetwork
from prbench_adapters.wandr.state import BodyState, clean_delta


@dataclass(frozen=True)
class Start:
    """What is known before the first step of B sequences. World with Z up, metres; one precision throughout."""

    state: BodyState
    """The first frame."""
    delta: Float[torch.Tensor, "batch 135"]
    """The change that led to it."""
    offsets: Float[torch.Tensor, "batch 22 3"]
    """The skeletons at rest."""
    goal: Float[torch.Tensor, "batch 3"]
    """Where the right wrist is to be in the last frame."""
    n_frames: Int[torch.Tensor, " batch"]
    """Frames of each sequence, the first among them."""


@torch.no_grad()
def roll_out(
    network: WandrNetwork, start: Start, noise: Float[torch.Tensor, "batch steps latent"]
) -> Float[torch.Tensor, "batch frames 22 3"]:
    """Joints of all frames; those behind a sequence's own number of frames are padding.

    Args:
        network: In evaluation mode, of the precision of ``start``.
        start: Where the sequences begin, and where they are to go.
        noise: Standard normal: the latent of each step.
    """
    state, delta = start.state, start.delta
    joints = [state.joints(start.offsets)]
    for step in range(noise.shape[1]):
        left = (start.n_frames - 1 - step).clamp_min(1)  # padding goes on as in its last frame
        delta = next_delta(
            network, state, delta, joints[-1], goal=start.goal, frames_left=left[:, None], latent=noise[:, step]
        )
        state = state.changed(delta)
        joints.append(state.joints(start.offsets))
    return torch.stack(joints, 1)


def next_delta(
    network: WandrNetwork,
    state: BodyState,
    delta: Float[torch.Tensor, "batch 135"],
    joints: Float[torch.Tensor, "batch 22 3"],
    *,
    goal: Float[torch.Tensor, "batch 3"],
    frames_left: Int[torch.Tensor, "batch 1"],
    latent: Float[torch.Tensor, "batch latent"],
) -> Float[torch.Tensor, "batch 135"]:
    """The change that follows a state.

    Args:
        network: The decoder's.
        state: Before the change.
        delta: The change that led to it.
        joints: Of the state.
        goal: Of the right wrist.
        frames_left: Until the goal.
        latent: What is drawn.
    """
    intention = intentions(
        state.yaw,
        wrist=joints[:, Joint.RIGHT_WRIST],
        pelvis=joints[:, Joint.PELVIS],
        goal=goal,
        frames_left=frames_left.to(goal),
        fps=network.configuration.fps,
    )
    decoded = network.decode(latent, network.condition(state.seen(), delta, intention))
    return clean_delta(network.delta.undone(decoded))
