"""The conditional variational autoencoder that DLow starts from.

Source: docs/specification/prediction-baselines.md#cvae.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench_adapters.prediction.recurrent import Perceptron, PoseDecoder, gaussian_kl, last_state, latent_noise

_CONSTANT_EPOCHS = 100
_EPOCHS = 500


class CVAEConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes and weights of the loss.

    Raises:
        ValueError: for sizes below 1 and negative weights.
    """

    n_joints: int
    predicted: int = 60
    state: int = 128
    mlp: tuple[int, ...] = (300, 200)
    latent: int = 128
    first_frame: float = 1000.0
    """Weight of the first predicted frame's distance from the last observed one."""
    beta: float = 0.01
    """Weight of the divergence from the prior: 0.01 as on HumanEva, 0.1 as on H36M."""

    def __post_init__(self) -> None:
        for name in ("n_joints", "predicted", "state", "latent"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if not self.mlp or min(self.mlp) < 1:
            raise ValueError(f"'mlp' must be one or more positive widths, found {list(self.mlp)}")
        if self.first_frame < 0 or self.beta < 0:
            raise ValueError(f"'first_frame' and 'beta' must not be negative: {self.first_frame}, {self.beta}")

    @property
    def values(self) -> int:
        """Numbers of a pose."""
        return 3 * self.n_joints


@dataclass(frozen=True)
class CVAELoss:
    """Sums over frames and values, averaged over windows; the weighted sum is ``total``."""

    squared_error: Float[Tensor, ""]
    first_frame: Float[Tensor, ""]
    kl: Float[Tensor, ""]
    total: Float[Tensor, ""]


class CVAE(nn.Module):
    """Futures from a normal latent vector and the past.

    Args:
        configuration: Sizes.
    """

    def __init__(self, configuration: CVAEConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        values, state, mlp = configuration.values, configuration.state, configuration.mlp
        self.past = nn.GRU(values, state, batch_first=True)
        self.future = nn.GRU(values, state, batch_first=True)
        self.posterior = Perceptron([2 * state, *mlp])
        self.mean = nn.Linear(mlp[-1], configuration.latent)
        self.log_variance = nn.Linear(mlp[-1], configuration.latent)
        self.decoder = PoseDecoder(state + configuration.latent, state, state, mlp, values)

    def posterior_of(
        self,
        observed: Float[Tensor, "windows observed joints 3"],
        future: Float[Tensor, "windows predicted joints 3"],
    ) -> tuple[Float[Tensor, "windows latent"], Float[Tensor, "windows latent"]]:
        """Mean and logarithm of the variance of the latent vector, given past and future in metres."""
        states = [last_state(self.past, observed.flatten(2)), last_state(self.future, future.flatten(2))]
        hidden = self.posterior(torch.cat(states, dim=1))
        return self.mean(hidden), self.log_variance(hidden)

    def decode(
        self,
        observed: Float[Tensor, "windows observed joints 3"],
        latent: Float[Tensor, "windows samples latent"],
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """Futures in metres; the past is encoded once a window, all samples are decoded together."""
        samples = latent.shape[1]
        flat = observed.flatten(2)
        past = last_state(self.past, flat).repeat_interleave(samples, dim=0)
        pose = flat[:, -1].repeat_interleave(samples, dim=0)
        code = torch.cat([past, latent.flatten(0, 1)], dim=1)
        poses = self.decoder(code, past, pose, self.configuration.predicted)
        return poses.unflatten(-1, (-1, 3)).unflatten(0, (-1, samples))

    @torch.no_grad()
    def predict(
        self, observed: Float[Tensor, "windows observed joints 3"], seeds: Sequence[Sequence[int]]
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """Draw continuations in metres.

        Args:
            observed: Joints, metres.
            seeds: A seed for each sample of each window; nothing else decides about its noise.
        """
        return self.decode(observed, latent_noise(seeds, self.configuration.latent, observed))

    def loss(
        self,
        observed: Float[Tensor, "windows observed joints 3"],
        future: Float[Tensor, "windows predicted joints 3"],
        noise: Float[Tensor, "windows latent"],
    ) -> CVAELoss:
        """The loss of the reconstruction from a latent vector drawn with ``noise``, standard normal."""
        mean, log_variance = self.posterior_of(observed, future)
        latent = mean + (0.5 * log_variance).exp() * noise
        reconstruction = self.decode(observed, latent[:, None])[:, 0]
        n = len(observed)
        squared_error = (reconstruction - future).square().sum() / n
        # Tied to the last observed pose and not to the next true one, as published.
        first_frame = (reconstruction[:, 0] - observed[:, -1]).square().sum() / n
        kl = gaussian_kl(mean, log_variance).sum() / n
        total = squared_error + self.configuration.first_frame * first_frame + self.configuration.beta * kl
        return CVAELoss(squared_error, first_frame, kl, total)


def rate_factor(epoch: int, *, constant: int = _CONSTANT_EPOCHS, epochs: int = _EPOCHS) -> float:
    """Factor of the learning rate in an epoch counted from 0: 1 at first, then linearly to almost 0 at the end."""
    return 1.0 - max(0, epoch - constant) / (epochs - constant + 1)
