"""Body states of WANDR, the changes between them as seen without the yaw, and the network that makes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import msgspec
import torch
from jaxtyping import Float
from torch import nn

from prbench.geometry.skeleton import N_JOINTS, Joint
from prbench_adapters.kinematics import fitted_rotations, forward_kinematics, matrices_of, rows_of, unit
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.weights import Weights, weights_header

Latents = Float[torch.Tensor, "*batch latent"]
Poses = Float[torch.Tensor, "*batch 277"]
Changes = Float[torch.Tensor, "*batch 133"]
Intentions = Float[torch.Tensor, "*batch 9"]

# Numbers of a change: step of the pelvis, turn of the root, turns of the 21 other joints.
DELTA_SIZE = 3 + 6 * N_JOINTS
# Numbers of a state without its yaw and its place on the floor.
SEEN_SIZE = 1 + 6 * N_JOINTS
TRANSLATION = slice(0, 3)
ROOT = slice(3, 9)
# Parts of a change.
JOINTS = slice(9, DELTA_SIZE)

_LYING = 0.1  # length of the horizontal part of the left axis below which the body lies on its side (6 degrees)
INTENTION_SIZE = 9
_PELVIS_MOST = 2.0  # length of the pelvis intention towards goals far away
_SECONDS = 1e-5  # added to the remaining time
_ABOVE = 1e-6  # metres on the floor between pelvis and goal below which the goal has no direction


@dataclass(frozen=True)
class BodyState:
    """Place and pose of a body.

    Attributes:
        rotations: The root's orientation, and of each other joint the rotation relative to the one before.
    """

    pelvis: Float[torch.Tensor, "*batch 3"]
    rotations: Float[torch.Tensor, "*batch 22 3 3"]

    @classmethod
    def fitted(cls, joints: Float[torch.Tensor, "*batch 22 3"]) -> BodyState:
        """Return the state of given joint positions; exact in every bone's direction."""
        return cls(joints[..., Joint.PELVIS, :], fitted_rotations(joints))

    def __getitem__(self, index: Any) -> BodyState:
        """Return the states at these places of the leading axes."""
        return BodyState(self.pelvis[index], self.rotations[index])

    def joints(self, offsets: Float[torch.Tensor, "... 22 3"]) -> Float[torch.Tensor, "*batch 22 3"]:
        """Joint positions of a skeleton with these rest offsets, metres."""
        return forward_kinematics(self.rotations, self.pelvis, offsets)

    @cached_property
    def yaw(self) -> Float[torch.Tensor, "*batch 3 3"]:
        """Yaw of the root (:func:`yaw_rotation`)."""
        return yaw_rotation(self.rotations[..., 0, :, :])

    def seen(self) -> Changes:
        """Height, orientation without yaw, joint rotations: x(s)."""
        root = self.yaw.mT @ self.rotations[..., 0, :, :]
        return torch.cat((self.pelvis[..., 2:], rows_of(root), rows_of(self.rotations[..., 1:, :, :]).flatten(-2)), -1)

    def changed(self, delta: Float[torch.Tensor, "*batch 135"]) -> BodyState:
        """Return the state after a change; whatever the numbers are, rotations stay rotations."""
        step = self.yaw @ delta[..., TRANSLATION, None]
        turns = matrices_of(delta[..., 3:].unflatten(-1, (N_JOINTS, 6)))
        return BodyState(self.pelvis + step[..., 0], matrices_of(rows_of(self.rotations @ turns)))

    def delta_to(self, following: BodyState) -> Float[torch.Tensor, "*batch 135"]:
        """Return the change that leads to another state: :meth:`changed` undoes it."""
        step = self.yaw.mT @ (following.pelvis - self.pelvis)[..., None]
        return torch.cat((step[..., 0], rows_of(self.rotations.mT @ following.rotations).flatten(-2)), -1)


def clean_delta(delta: Float[torch.Tensor, "*batch 135"]) -> Float[torch.Tensor, "*batch 135"]:
    """Return a predicted change as it acts: its turns made rotations."""
    turns = rows_of(matrices_of(delta[..., 3:].unflatten(-1, (N_JOINTS, 6))))
    return torch.cat((delta[..., TRANSLATION], turns.flatten(-2)), -1)


def yaw_rotation(root: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 3 3"]:
    """Return the rotation about z that is the yaw of an orientation, without gradients.

    It is the first angle of the intrinsic ZYX Euler angles, which is the direction of the body's left axis. For a body
    that lies on its side that angle means nothing; there the facing axis decides. The original computes the yaw outside
    of the graph, which keeps the training on its own output stable.
    """
    left = root[..., :2, 0].detach()
    front = root[..., :2, 2].detach()
    # A left axis that points up or down has no direction on the floor.
    lying = left.norm(dim=-1, keepdim=True) < _LYING
    across = torch.where(lying, torch.stack((-front[..., 1], front[..., 0]), -1), left)
    zero = torch.zeros_like(across[..., :1])
    cos, sin, _ = unit(torch.cat((across, zero), -1)).split(1, -1)
    return torch.cat((cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1), -1).unflatten(-1, (3, 3))


def heading_of(yaw: Float[torch.Tensor, "*batch 3 3"]) -> Float[torch.Tensor, "*batch 3"]:
    """Return the horizontal direction that a body of this yaw faces."""
    return -yaw[..., :, 1]


def intentions(
    yaw: Float[torch.Tensor, "*batch 3 3"],
    *,
    wrist: Float[torch.Tensor, "*batch 3"],
    pelvis: Float[torch.Tensor, "*batch 3"],
    goal: Float[torch.Tensor, "*batch 3"],
    frames_left: Float[torch.Tensor, "*batch 1"],
    fps: float,
    goal_heading: Float[torch.Tensor, "*batch 3"] | None = None,
    most_speed: float = math.inf,
) -> Intentions:
    """Intentions of wrist, pelvis and heading, all seen from the body's yaw; they are never standardised.

    Args:
        yaw: Yaw of the body (:func:`prbench_adapters.wandr.network.yaw_rotation`).
        wrist: Its right wrist, metres, Z up.
        pelvis: Its pelvis, metres, Z up.
        goal: Place that the wrist is to reach.
        frames_left: Frames until then.
        fps: Frames per second.
        goal_heading: Unit vector that the body should face then; towards the goal by default.
        most_speed: Longest intention of the wrist, metres a second; a longer one keeps its direction.
    """
    heading = heading_of(yaw)
    if goal_heading is None:
        to_goal = (goal - pelvis) * goal.new_tensor((1.0, 1.0, 0.0))
        goal_heading = torch.where(to_goal.norm(dim=-1, keepdim=True) < _ABOVE, heading, unit(to_goal))
    # The velocity that would bring the wrist to the goal just in time.
    velocity = _turned(yaw, goal - wrist) / (frames_left / fps + _SECONDS)
    if most_speed < math.inf:
        velocity = velocity * (most_speed / velocity.norm(dim=-1, keepdim=True).clamp_min(most_speed))
    approach = _turned(yaw, goal - pelvis)
    distance = approach.norm(dim=-1, keepdim=True)
    # Saturates with the distance: a goal ten metres away asks for no faster walk than one four metres away.
    approach = _PELVIS_MOST * (1 - torch.exp(-distance)) * unit(approach) * goal.new_tensor((1.0, 1.0, 0.0))
    return torch.cat((velocity, approach, _turned(yaw, goal_heading - heading)), -1)


def _turned(yaw: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """World vectors as the yaw frame sees them."""
    return (yaw.mT @ vectors[..., None])[..., 0]


CONDITION_SIZE = SEEN_SIZE + DELTA_SIZE + INTENTION_SIZE
_SMALLEST = 1e-5  # added to every standard deviation
KIND = "wandr"
REPRESENTATION = "wandr-135"


class WandrConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of encoder and decoder; the defaults are those of the original (docs/specification/wandr.md#network).

    Raises:
        ValueError: for sizes that are not possible.

    Attributes:
        layers: Linear layers of the encoder, and of the decoder.
        widest: No hidden layer is wider; without effect on the original's sizes.
        original_deviation: Draw the latent with exp(v) as its deviation, as the public program does, though its KL
            divergence takes v for a log-variance; otherwise with exp(v / 2). Only training draws from the encoder.
        most_speed: Longest intention of the wrist that the network is shown, metres a second, in training and in
            generation; 0 is no limit, as in the original. A body that is late is then asked for speeds that no training
            motion has, and falls towards the goal (docs/methods/wandr.md).
    """

    layers: int = 14
    widest: int = 512
    latent: int = 64
    dropout: float = 0.03
    fps: float = 30.0
    original_deviation: bool = False
    most_speed: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "layers", "widest", "latent")
        require_within(self, "at least 0 and below 1", "dropout")
        require_within(self, "above 0", "fps")
        require_within(self, "at least 0", "most_speed")

    @property
    def speed_limit(self) -> float:
        """The longest intention of the wrist, metres a second; infinite where there is no limit."""
        return self.most_speed or math.inf


class Standardisation(nn.Module):
    """Mean and standard deviation of each number; kept with the weights, never trained."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.mean: torch.Tensor
        self.std: torch.Tensor
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def forward(self, values: Float[torch.Tensor, "*batch size"]) -> Float[torch.Tensor, "*batch size"]:
        """Standardised values."""
        return (values - self.mean) / (self.std + _SMALLEST)

    def undone(self, values: Float[torch.Tensor, "*batch size"]) -> Float[torch.Tensor, "*batch size"]:
        """Return the values that were standardised."""
        return values * (self.std + _SMALLEST) + self.mean


class WandrNetwork(nn.Module):
    """Encoder (next change, condition) to a latent distribution; decoder (latent, condition) to the next change."""

    def __init__(self, configuration: WandrConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        self.encoder = _stack(DELTA_SIZE + CONDITION_SIZE, 2 * configuration.latent, configuration)
        self.decoder = _stack(configuration.latent + CONDITION_SIZE, DELTA_SIZE, configuration)
        self.seen, self.delta = Standardisation(SEEN_SIZE), Standardisation(DELTA_SIZE)

    def condition(self, seen: Changes, delta: Float[torch.Tensor, "*batch 135"], intention: Intentions) -> Poses:
        """Return condition of a step, from a state without yaw, the change that led to it, and intentions; all raw."""
        return torch.cat((self.seen(seen), self.delta(delta), intention), -1)

    def encode(self, delta: Float[torch.Tensor, "*batch 135"], condition: Poses) -> tuple[Latents, Latents]:
        """Mean and log-variance of the latent of a standardised change."""
        mean, log_variance = self.encoder(torch.cat((delta, condition), -1)).chunk(2, -1)
        return mean, log_variance

    def draw(self, mean: Latents, log_variance: Latents, noise: Latents) -> Latents:
        """Return a latent of the distribution, from standard normal noise."""
        return mean + noise * (log_variance * (1.0 if self.configuration.original_deviation else 0.5)).exp()

    def decode(self, latent: Latents, condition: Poses) -> Float[torch.Tensor, "*batch 135"]:
        """Return the next change, standardised."""
        return self.decoder(torch.cat((latent, condition), -1))


def hidden_widths(inputs: int, outputs: int, layers: int, widest: int) -> list[int]:
    """Widths between input and output: on the straight line between both, rounded up to powers of two."""
    # As the original sizes its layers (docs/specification/wandr.md#network).
    line = [inputs + (outputs - inputs) * place / layers for place in range(1, layers)]
    return [min(widest, 1 << (math.ceil(width) - 1).bit_length()) for width in line]


def _stack(inputs: int, outputs: int, configuration: WandrConfiguration) -> nn.Sequential:
    """Dropout, LayerNorm, Linear and ReLU in each layer; no ReLU in the last."""
    widths = [inputs, *hidden_widths(inputs, outputs, configuration.layers, configuration.widest), outputs]
    modules: list[nn.Module] = []
    for before, after in pairwise(widths):
        modules += [nn.Dropout(configuration.dropout), nn.LayerNorm(before), nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*modules[:-1])


def contents(network: WandrNetwork) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """Tensors and header entries of a network."""
    metadata = weights_header(KIND, network.configuration, REPRESENTATION)
    return {f"network.{name}": tensor for name, tensor in network.state_dict().items()}, metadata


def network_of(weights: Weights) -> WandrNetwork:
    """Return the network that a file holds.

    Raises:
        InputFileError: if the tensors do not fit the configuration in the header.
    """
    network = WandrNetwork(weights.configuration(WandrConfiguration))
    weights.load_into(network, "network")
    return network
