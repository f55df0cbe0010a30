"""DLow: K latent vectors that are designed together, by affine maps of one noise vector a window.

Source: docs/specification/prediction-baselines.md#dlow-sampler.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench_adapters.prediction.cvae import CVAE
from prbench_adapters.prediction.recurrent import Perceptron, gaussian_kl, last_state, latent_noise

_SMALLEST_VARIANCE = 1e-12
_VALUES_OF_HUMANEVA = 42


class DLowConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the sampler and weights of its loss.

    Raises:
        ValueError: for sizes below 1.
    """

    n_samples: int = 50
    """K: the samples are one design, so a model answers with exactly so many."""
    state: int = 128
    mlp: tuple[int, ...] = (1024, 512)
    kl: float = 1.0
    diversity: float = 50.0
    best_of_k: float = 2.0
    scale: float = 20.0
    """Squared distance, m², over which diversity falls by e, for poses of 42 numbers."""
    scale_by_size: bool = True
    """Whether the distance grows with the numbers of a pose; the published program has one for each data set."""

    def __post_init__(self) -> None:
        if self.n_samples < 2:
            raise ValueError(f"'n_samples' must be at least 2, so that samples can differ, found {self.n_samples}")
        if self.state < 1 or not self.mlp or min(self.mlp) < 1:
            raise ValueError(f"'state' and 'mlp' must be positive widths, found {self.state} and {list(self.mlp)}")
        if not self.scale > 0:
            raise ValueError(f"'scale' must be positive, found {self.scale}")


@dataclass(frozen=True)
class DLowLoss:
    """Means over windows; the weighted sum is ``total``."""

    kl: Float[Tensor, ""]
    diversity: Float[Tensor, ""]
    best_of_k: Float[Tensor, ""]
    total: Float[Tensor, ""]


class DLow(nn.Module):
    """A sampler of latent vectors for a trained CVAE, which stays as it is.

    Args:
        configuration: Sizes and weights.
        cvae: Trained; its parameters are frozen here.
    """

    def __init__(self, configuration: DLowConfiguration, cvae: CVAE) -> None:
        super().__init__()
        self.configuration = configuration
        # Without this, gradients that nobody uses would pile up in the decoder.
        self.cvae = cvae.requires_grad_(False)
        values, size = cvae.configuration.values, configuration.n_samples * cvae.configuration.latent
        self.past = nn.GRU(values, configuration.state, batch_first=True)
        self.mlp = Perceptron([configuration.state, *configuration.mlp])
        self.scales = nn.Linear(configuration.mlp[-1], size)
        self.shifts = nn.Linear(configuration.mlp[-1], size)

    def maps(
        self, observed: Float[Tensor, "windows observed joints 3"]
    ) -> tuple[Float[Tensor, "windows samples latent"], Float[Tensor, "windows samples latent"]]:
        """Scale a and shift b of each sample's map."""
        hidden = self.mlp(last_state(self.past, observed.flatten(2)))
        shape = (self.configuration.n_samples, self.cvae.configuration.latent)
        return self.scales(hidden).unflatten(-1, shape), self.shifts(hidden).unflatten(-1, shape)

    def decode(
        self, observed: Float[Tensor, "windows observed joints 3"], noise: Float[Tensor, "windows latent"]
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """All K futures in metres of one noise vector a window."""
        scale, shift = self.maps(observed)
        return self.cvae.decode(observed, scale * noise[:, None] + shift)

    @torch.no_grad()
    def predict(
        self, observed: Float[Tensor, "windows observed joints 3"], seeds: Sequence[Sequence[int]]
    ) -> Float[Tensor, "windows samples predicted joints 3"]:
        """Draw all K continuations of each window, metres.

        Args:
            observed: Joints, metres.
            seeds: K seeds for each window, of which the first decides: one noise vector makes all samples.

        Raises:
            ValueError: for another number of samples than K.
        """
        wanted = self.configuration.n_samples
        found = sorted({len(row) for row in seeds})
        if found != [wanted]:
            raise ValueError(f"expected {wanted} samples of each window, which are one design, found {found}")
        noise = latent_noise([row[:1] for row in seeds], self.cvae.configuration.latent, observed)
        return self.decode(observed, noise[:, 0])

    def loss(
        self,
        observed: Float[Tensor, "windows observed joints 3"],
        future: Float[Tensor, "windows predicted joints 3"],
        noise: Float[Tensor, "windows latent"],
    ) -> DLowLoss:
        """Divergence from the prior, similarity of the samples, and error of the best one."""
        scale, shift = self.maps(observed)
        predicted = self.cvae.decode(observed, scale * noise[:, None] + shift).flatten(2)
        # A scale of 0 would have no logarithm.
        kl = gaussian_kl(shift, scale.square().clamp_min(_SMALLEST_VARIANCE).log()).mean()
        diversity = (-_squared_distances(predicted) / self.scale).exp().mean()
        best = (predicted - future.flatten(1)[:, None]).square().sum(dim=-1).amin(dim=1).mean()
        weights = self.configuration
        total = weights.kl * kl + weights.diversity * diversity + weights.best_of_k * best
        return DLowLoss(kl, diversity, best, total)

    @property
    def scale(self) -> float:
        """Squared distance, m², over which diversity falls by e, for this body."""
        if not self.configuration.scale_by_size:
            return self.configuration.scale
        return self.configuration.scale * self.cvae.configuration.values / _VALUES_OF_HUMANEVA


def _squared_distances(futures: Float[Tensor, "windows samples values"]) -> Float[Tensor, "windows pairs"]:
    """Squared distance of every two futures of a window, m², without a difference of every two."""
    # Seen from their mean, products of futures are not much larger than the distances that they give.
    centred = futures - futures.mean(dim=1, keepdim=True)
    products = centred @ centred.transpose(1, 2)
    squares = products.diagonal(dim1=1, dim2=2)
    apart = squares[:, :, None] + squares[:, None] - 2.0 * products
    first, second = torch.triu_indices(futures.shape[1], futures.shape[1], 1, device=futures.device)
    return apart[:, first, second]
