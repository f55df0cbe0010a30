"""BeLFusion's two autoencoders: a code of the past, and of the future a behaviour that can follow another past.

Source: docs/specification/prediction-baselines.md#belfusion.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.utils.parametrizations import weight_norm

from prbench_adapters.prediction.recurrent import PoseDecoder, gaussian_kl, last_state


class BehaviourConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of both autoencoders and weights of the losses; the defaults are those of H36M.

    Raises:
        ValueError: for sizes below 1.
    """

    n_joints: int
    observed: int = 15
    predicted: int = 60
    context: int = 3
    """Last observed frames that a behaviour is joined to, and that belong to what it describes."""
    past: int = 64
    """Width of the code of the past."""
    mlp: tuple[int, ...] = (300, 200)
    offsets_summed: bool = True
    """Whether decoded offsets of the past are summed over frames, or added to the first pose."""
    behaviour: int = 128
    decoder: int = 128
    context_width: int = 128
    beta: float = 1e-4
    """Weight of the divergence from the prior."""
    delta: float = 1.05
    """Weight of the auxiliary decoder's error, which the behaviour is to make large: it shall not hold poses."""

    def __post_init__(self) -> None:
        sizes = ("n_joints", "observed", "predicted", "context", "past", "behaviour", "decoder", "context_width")
        for name in sizes:
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if self.context > self.observed:
            raise ValueError(f"'context' must be at most the {self.observed} observed frames, found {self.context}")
        if not self.mlp or min(self.mlp) < 1:
            raise ValueError(f"'mlp' must be one or more positive widths, found {list(self.mlp)}")

    @property
    def values(self) -> int:
        """Numbers of a pose."""
        return 3 * self.n_joints


class PastAutoencoder(nn.Module):
    """A code of the observed frames, and the frames from the code and the pose before them.

    Args:
        configuration: Sizes.
    """

    def __init__(self, configuration: BehaviourConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        values, past = configuration.values, configuration.past
        self.encoder = nn.GRU(values, past, batch_first=True)
        self.decoder = PoseDecoder(past, past, past, configuration.mlp, values)

    def code(self, observed: Float[Tensor, "windows frames joints 3"]) -> Float[Tensor, "windows past"]:
        """The code of observed frames in metres."""
        return last_state(self.encoder, observed.flatten(2))

    def forward(self, motion: Float[Tensor, "windows frames joints 3"]) -> Float[Tensor, "windows frames joints 3"]:
        """The first frame as it is, and the others from their code."""
        frames = motion.flatten(2)
        start = frames[:, 0]
        code = self.code(motion[:, 1:])
        offsets = self.decoder(code, code, start, frames.shape[1] - 1)
        if self.configuration.offsets_summed:
            offsets = offsets.cumsum(dim=1)
        return torch.cat([frames[:, :1], start[:, None] + offsets], dim=1).unflatten(-1, (-1, 3))

    def loss(self, motion: Float[Tensor, "windows frames joints 3"]) -> Float[Tensor, ""]:
        """Mean squared error of all frames, m²."""
        return (self(motion) - motion).square().mean()


@dataclass(frozen=True)
class Behaviour:
    """What a behaviour is drawn from."""

    hidden: Float[Tensor, "windows behaviour"]
    mean: Float[Tensor, "windows behaviour"]
    log_deviation: Float[Tensor, "windows behaviour"]

    def draw(self, noise: Float[Tensor, "windows behaviour"]) -> Float[Tensor, "windows behaviour"]:
        """One behaviour a window, from standard normal noise; published evaluation draws it too."""
        return self.mean + self.log_deviation.exp() * noise


@dataclass(frozen=True)
class BehaviourLoss:
    """Sums over frames and values, averaged over windows, m²; the weighted sum is ``total``."""

    squared_error: Float[Tensor, ""]
    kl: Float[Tensor, ""]
    auxiliary: Float[Tensor, ""]
    total: Float[Tensor, ""]


class BehaviourAutoencoder(nn.Module):
    """A behaviour of context and future, and poses from a behaviour and any context.

    Args:
        configuration: Sizes and weights.
    """

    def __init__(self, configuration: BehaviourConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        values, size, width = configuration.values, configuration.behaviour, configuration.decoder
        self.encoder = nn.LSTM(values, size, batch_first=True)
        self.mean = _ScaledLinear(size)
        self.log_deviation = _ScaledLinear(size)
        self.context = nn.Linear(configuration.context * values, configuration.context_width)
        self.coupler = nn.GRU(size + configuration.context_width, width, batch_first=True)
        self.offset = nn.Linear(width, values)
        self.auxiliary = nn.GRU(size, width, batch_first=True)
        self.auxiliary_pose = nn.Linear(width, values)

    def encode(self, sequence: Float[Tensor, "windows frames joints 3"]) -> Behaviour:
        """The behaviour of context and future, in metres."""
        hidden = last_state(self.encoder, sequence.flatten(2))
        return Behaviour(hidden, self.mean(hidden), self.log_deviation(hidden))

    def decode(
        self,
        context: Float[Tensor, "windows context joints 3"],
        behaviour: Float[Tensor, "windows samples behaviour"],
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """Futures in metres that go on from the context, which is encoded once a window."""
        samples = behaviour.shape[1]
        flat = context.flatten(2)
        told = self.context(flat.flatten(1))[:, None].expand(-1, samples, -1)
        steps = torch.cat([behaviour, told], dim=2).flatten(0, 1)
        steps = steps[:, None].expand(-1, self.configuration.predicted, -1)
        offsets = self.offset(self.coupler(steps)[0]).unflatten(0, (-1, samples))
        return (flat[:, None, -1:] + offsets).unflatten(-1, (-1, 3))

    def decode_without_context(
        self, behaviour: Float[Tensor, "windows behaviour"]
    ) -> Float[Tensor, "windows frames joints 3"]:
        """What the auxiliary decoder can tell of context and future from the behaviour alone."""
        frames = self.configuration.context + self.configuration.predicted
        steps = behaviour[:, None].expand(-1, frames, -1)
        return self.auxiliary_pose(self.auxiliary(steps)[0]).unflatten(-1, (-1, 3))

    def loss(
        self, sequence: Float[Tensor, "windows frames joints 3"], noise: Float[Tensor, "windows behaviour"]
    ) -> BehaviourLoss:
        """The loss of encoder and coupler, and that of the auxiliary decoder beside it."""
        found = self.encode(sequence)
        behaviour = found.draw(noise)
        n = len(sequence)
        context, future = sequence.split([self.configuration.context, self.configuration.predicted], dim=1)
        squared_error = (self.decode(context, behaviour[:, None])[:, 0] - future).square().sum() / n
        # The published program puts the logarithm of the deviation where that of the variance belongs.
        kl = gaussian_kl(found.mean, found.log_deviation).sum() / n
        auxiliary = (self.decode_without_context(behaviour) - sequence).square().sum() / n
        total = squared_error + self.configuration.beta * kl - self.configuration.delta * auxiliary
        return BehaviourLoss(squared_error, kl, auxiliary, total)


class _ScaledLinear(nn.Module):
    """γ ⊙ (g v/‖v‖ · p + c) + β for each row."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.linear = weight_norm(nn.Linear(size, size))
        self.scale = nn.Parameter(torch.ones(size))
        self.shift = nn.Parameter(torch.zeros(size))

    def forward(self, hidden: Float[Tensor, "batch size"]) -> Float[Tensor, "batch size"]:
        return self.scale * self.linear(hidden) + self.shift
