"""The recurrent predictors CVAE and DLow, and the perceptrons and states that they share with BeLFusion.

Source: docs/specification/prediction-baselines.md#common. Joints are in metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from prbench.randomness import sequence_generator
from prbench_adapters.training.configuration import require_within

Observed = Float[Tensor, "windows observed joints 3"]
Future = Float[Tensor, "windows predicted joints 3"]
Futures = Float[Tensor, "windows samples predicted joints 3"]
Latent = Float[Tensor, "windows latent"]
Latents = Float[Tensor, "windows samples latent"]
Losses = dict[str, Float[Tensor, ""]]  # Scalars by name; ``loss`` is minimised.
Seeds = Sequence[Sequence[int]]  # A seed for each sample of each window; nothing else decides about its noise.
_SMALLEST_VARIANCE = 1e-12
_VALUES_OF_HUMANEVA = 42


def perceptron(sizes: Sequence[int]) -> nn.Sequential:
    """Linear layers with a tanh behind each, the last one too."""
    return nn.Sequential(*(layer for ends in pairwise(sizes) for layer in (nn.Linear(*ends), nn.Tanh())))


def last_state(layer: nn.GRU | nn.LSTM, sequence: Float[Tensor, "batch frames size"]) -> Float[Tensor, "batch state"]:
    """Return the state that a sequence leaves in a recurrent layer; batch first."""
    return layer(sequence)[0][:, -1]


def latent_noise(seeds: Seeds, size: int, like: Tensor) -> Float[Tensor, "windows samples size"]:
    """Return standard normal noise, each sample's from its own seed alone; of the type and device of ``like``."""
    draws = [[sequence_generator(seed).standard_normal(size, dtype=np.float32) for seed in row] for row in seeds]
    return torch.from_numpy(np.array(draws)).to(like)


def gaussian_kl(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Kullback-Leibler divergence of a diagonal Gaussian from the standard one over the last axis, nats."""
    return -0.5 * (1.0 + log_variance - mean.square() - log_variance.exp()).sum(dim=-1)


def require_sizes(configuration: msgspec.Struct, *names: str) -> None:
    """Refuse sizes below 1, and a perceptron without or with empty layers.

    Raises:
        ValueError: naming the size.
    """
    require_within(configuration, "at least 1", *names)
    mlp = getattr(configuration, "mlp", (1,))
    if not mlp or min(mlp) < 1:
        raise ValueError(f"'mlp' must be one or more positive widths, found {list(mlp)}")


class PoseDecoder(nn.Module):
    """Poses one after another: each depends on a code, the pose before it, and the state of a recurrent cell.

    Args:
        code: Numbers that stay the same over all frames.
        start: Numbers that the first state is made of.
        state: Width of the cell.
        mlp: Widths of the perceptrons before the first state and before the pose.
        values: Numbers of a pose.
    """

    def __init__(self, code: int, start: int, state: int, mlp: Sequence[int], values: int) -> None:
        super().__init__()
        self.first_state = perceptron([start, *mlp, state])
        self.cell = nn.GRUCell(code + values, state)
        self.mlp = perceptron([state, *mlp])
        self.output = nn.Linear(mlp[-1], values)

    def forward(self, code: Tensor, start: Tensor, pose: Tensor, frames: int) -> Float[Tensor, "batch frames values"]:
        """Return outputs of ``frames`` frames from (batch, numbers) each; ``pose`` is what stands before the first."""
        state = self.first_state(start)
        poses = []
        for _ in range(frames):
            state = self.cell(torch.cat([code, pose], dim=1), state)
            pose = self.output(self.mlp(state))
            poses.append(pose)
        return torch.stack(poses, dim=1)


class CVAEConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes and weights of the loss.

    Attributes:
        first_frame: Weight of the first predicted frame's distance from the last observed one.
        beta: Weight of the divergence from the prior: 0.01 as on HumanEva, 0.1 as on H36M.

    Raises:
        ValueError: for sizes below 1 and negative weights.
    """

    n_joints: int
    predicted: int = 60
    state: int = 128
    mlp: tuple[int, ...] = (300, 200)
    latent: int = 128
    first_frame: float = 1000.0
    beta: float = 0.01

    def __post_init__(self) -> None:
        require_sizes(self, "n_joints", "predicted", "state", "latent")
        require_within(self, "at least 0", "first_frame", "beta")

    @property
    def values(self) -> int:
        """Numbers of a pose."""
        return 3 * self.n_joints


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
        self.posterior = perceptron([2 * state, *mlp])
        self.mean = nn.Linear(mlp[-1], configuration.latent)
        self.log_variance = nn.Linear(mlp[-1], configuration.latent)
        self.decoder = PoseDecoder(state + configuration.latent, state, state, mlp, values)

    def posterior_of(self, observed: Observed, future: Future) -> tuple[Latent, Latent]:
        """Mean and logarithm of the variance of the latent vector, given past and future."""
        states = [last_state(self.past, observed.flatten(2)), last_state(self.future, future.flatten(2))]
        hidden = self.posterior(torch.cat(states, dim=1))
        return self.mean(hidden), self.log_variance(hidden)

    def decode(self, observed: Observed, latent: Latents) -> Futures:
        """Futures; the past is encoded once a window, all samples are decoded together."""
        samples = latent.shape[1]
        flat = observed.flatten(2)
        past = last_state(self.past, flat).repeat_interleave(samples, dim=0)
        pose = flat[:, -1].repeat_interleave(samples, dim=0)
        poses = self.decoder(torch.cat([past, latent.flatten(0, 1)], dim=1), past, pose, self.configuration.predicted)
        return poses.unflatten(-1, (-1, 3)).unflatten(0, (-1, samples))

    @torch.no_grad()
    def predict(self, observed: Observed, seeds: Seeds) -> Futures:
        """Draw continuations."""
        return self.decode(observed, latent_noise(seeds, self.configuration.latent, observed))

    def loss(self, observed: Observed, future: Future, noise: Latent) -> Losses:
        """Return the loss of the reconstruction from a latent vector drawn with ``noise``, standard normal.

        Returns:
            ``loss``, the weighted sum, and its parts: sums over frames and values, averaged over windows, m².
        """
        mean, log_variance = self.posterior_of(observed, future)
        reconstruction = self.decode(observed, (mean + (0.5 * log_variance).exp() * noise)[:, None])[:, 0]
        n = len(observed)
        squared_error = (reconstruction - future).square().sum() / n
        # Tied to the last observed pose and not to the next true one, as published.
        first_frame = (reconstruction[:, 0] - observed[:, -1]).square().sum() / n
        kl = gaussian_kl(mean, log_variance).sum() / n
        total = squared_error + self.configuration.first_frame * first_frame + self.configuration.beta * kl
        return {"loss": total, "squared_error": squared_error, "first_frame": first_frame, "kl": kl}


class DLowConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the sampler and weights of its loss.

    Attributes:
        n_samples: K: the samples are one design, so a model answers with exactly so many.
        scale: Squared distance, m², over which diversity falls by e, for poses of 42 numbers.
        scale_by_size: Whether the distance grows with the numbers of a pose; the published program has one for each
            data set.

    Raises:
        ValueError: for sizes below 1.
    """

    n_samples: int = 50
    state: int = 128
    mlp: tuple[int, ...] = (1024, 512)
    kl: float = 1.0
    diversity: float = 50.0
    best_of_k: float = 2.0
    scale: float = 20.0
    scale_by_size: bool = True

    def __post_init__(self) -> None:
        require_sizes(self, "state")
        if self.n_samples < 2:
            raise ValueError(f"'n_samples' must be at least 2, so that samples can differ, found {self.n_samples}")
        require_within(self, "above 0", "scale")


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
        self.mlp = perceptron([configuration.state, *configuration.mlp])
        self.scales = nn.Linear(configuration.mlp[-1], size)
        self.shifts = nn.Linear(configuration.mlp[-1], size)

    def maps(self, observed: Observed) -> tuple[Latents, Latents]:
        """Scale a and shift b of each sample's map."""
        hidden = self.mlp(last_state(self.past, observed.flatten(2)))
        shape = (self.configuration.n_samples, self.cvae.configuration.latent)
        return self.scales(hidden).unflatten(-1, shape), self.shifts(hidden).unflatten(-1, shape)

    def decode(self, observed: Observed, noise: Latent) -> Futures:
        """All K futures of one noise vector a window."""
        scale, shift = self.maps(observed)
        return self.cvae.decode(observed, scale * noise[:, None] + shift)

    @torch.no_grad()
    def predict(self, observed: Observed, seeds: Seeds) -> Futures:
        """Draw all K continuations of each window; of K seeds the first decides: one noise vector makes all samples.

        Raises:
            ValueError: for another number of samples than K.
        """
        wanted = self.configuration.n_samples
        found = sorted({len(row) for row in seeds})
        if found != [wanted]:
            raise ValueError(f"expected {wanted} samples of each window, which are one design, found {found}")
        noise = latent_noise([row[:1] for row in seeds], self.cvae.configuration.latent, observed)
        return self.decode(observed, noise[:, 0])

    def loss(self, observed: Observed, future: Future, noise: Latent) -> Losses:
        """Divergence from the prior, similarity of the samples, and error of the best one; ``loss`` is their sum."""
        scale, shift = self.maps(observed)
        predicted = self.cvae.decode(observed, scale * noise[:, None] + shift).flatten(2)
        # A scale of 0 would have no logarithm.
        kl = gaussian_kl(shift, scale.square().clamp_min(_SMALLEST_VARIANCE).log()).mean()
        # Squared distance of every two futures of a window, m², without a difference of every two.
        # Seen from their mean, products of futures are not much larger than the distances that they give.
        centred = predicted - predicted.mean(dim=1, keepdim=True)
        products = centred @ centred.transpose(1, 2)
        squares = products.diagonal(dim1=1, dim2=2)
        apart = squares[:, :, None] + squares[:, None] - 2.0 * products
        first, second = torch.triu_indices(predicted.shape[1], predicted.shape[1], 1, device=predicted.device)
        diversity = (-apart[:, first, second] / self.scale).exp().mean()
        best = (predicted - future.flatten(1)[:, None]).square().sum(dim=-1).amin(dim=1).mean()
        weights = self.configuration
        total = weights.kl * kl + weights.diversity * diversity + weights.best_of_k * best
        return {"loss": total, "kl": kl, "diversity": diversity, "best_of_k": best}

    @property
    def scale(self) -> float:
        """Squared distance, m², over which diversity falls by e, for this body."""
        if not self.configuration.scale_by_size:
            return self.configuration.scale
        return self.configuration.scale * self.cvae.configuration.values / _VALUES_OF_HUMANEVA
