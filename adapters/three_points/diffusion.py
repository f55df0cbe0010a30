"""Bodies from head and wrists by diffusion: BoDiffusion's transformer as published, and a small denoiser of our own.

Source: docs/specification/three-points.md#diffusion. Both share one sampler. Its state is the local rotations of a
whole track, root first, each as the first two columns of its matrix; in each step windows of it are denoised, then
averaged.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench.randomness import sequence_generator
from prbench_adapters.diffusion.denoiser import FrameLayer, SelfAttention, from_zero, sinusoid_table
from prbench_adapters.diffusion.sampling import Chain, CosineSchedule, LinearSchedule, ddim_factors
from prbench_adapters.three_points.features import TrackWindows, in_head_frame, joints_under_head, matrices_of_columns
from prbench_adapters.training.configuration import require_within

Rotations = Float[Tensor, "*windows frames 22 6"]
Track = Float[Tensor, "track 22 6"]
Features = Float[Tensor, "windows frames 54"]
Steps = Int[Tensor, " windows"]  # index in the training schedule
Turns = Float[Tensor, "windows 3 3"]
_TIME = 256  # numbers of the embedding of a step
_NOISE_FREE = 49  # last steps of the published sampling, in which no noise is added
_HALF_BIN = 1.0 / 255.0  # the published likelihood of clean values takes them for those of 8-bit pictures
_LAST_BIN = 0.999
_VELOCITY_WEIGHT = 0.05
_START_SCALE = 0.5  # of our sampling: less noise than in training, and fewer bodies that sit where they should stand
_REST = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0)  # columns of a joint that is not turned


class DiffusionConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the network, its windows and steps; as published by default.

    Attributes:
        network: ``published``: :class:`BoDiffusion`; ``frames``: :class:`WindowDenoiser`, made for small sizes.
        window: Frames of a window.
        slide: Frames between the beginnings of two windows of a longer track.
        diffusion_steps: Steps T of the training.
        sampling_steps: Steps that are taken of them.
    """

    network: Literal["published", "frames"] = "published"
    width: int = 384
    heads: int = 6
    layers: int = 12
    window: int = 41
    slide: int = 20
    diffusion_steps: int = 1000
    sampling_steps: int = 1000
    fps: float = 60.0

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "width", "heads", "layers", "window", "slide", "sampling_steps", "fps")
        if self.width % self.heads or self.width % 2:
            raise ValueError(f"'width' must be even and a multiple of 'heads', found {self.width} and {self.heads}")
        if self.slide > self.window or max(self.sampling_steps, 2) > self.diffusion_steps:
            problem = "'slide' must be at most 'window', and 'sampling_steps' and 2 at most 'diffusion_steps'"
            found = f"{self.slide}, {self.window}, {self.sampling_steps} and {self.diffusion_steps}"
            raise ValueError(f"{problem}, found {found}")


class BoDiffusion(nn.Module):
    """Predicts the noise in the rotations of a window, and the variance of each step."""

    def __init__(self, shape: DiffusionConfiguration) -> None:
        super().__init__()
        width = shape.width
        self.schedule = LinearSchedule(shape.diffusion_steps)
        self.condition = nn.Linear(3, 22, bias=False)
        self.frame_embedding = nn.Linear(22 * 24, width)
        # All zero in the published program, which so cannot tell the order of the frames.
        self.register_buffer("places", sinusoid_table(shape.window, width))
        self.places: Tensor
        self.time_embedding = nn.Sequential(nn.Linear(_TIME, width), nn.SiLU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(_Block(width, shape.heads) for _ in range(shape.layers))
        self.frame_head = nn.Linear(width, 22 * 24)
        self.joint_head = nn.Linear(24, 12)
        table = sinusoid_table(shape.diffusion_steps, _TIME)
        # All cosines stand in front of all sines.
        self.register_buffer("sinusoid", torch.cat((table[:, 1::2], table[:, ::2]), dim=1), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Rotations, features: Features, step: Steps) -> Float[Tensor, "windows frames 22 12"]:
        """Return the noise, and behind it a share of the logarithm of the largest variance: -1 for none, 1 for all."""
        stream = self.frame_embedding(torch.cat((noisy, self.told(features)), dim=-1).flatten(2))
        stream = stream + self.places[: noisy.shape[1]]
        time = functional.silu(self.time_embedding(self.sinusoid[step]))
        for block in self.blocks:
            stream = block(stream, time)
        return self.joint_head(self.frame_head(stream).unflatten(-1, (22, 24)))

    def told(self, features: Features) -> Float[Tensor, "windows frames 22 18"]:
        """Return the condition of each joint: the 54 values are cut into three groups of 18, and the groups mixed."""
        return self.condition(features.unflatten(-1, (3, 18)).mT).mT

    def estimate(self, noisy: Rotations, features: Features, chain: Chain, place: Steps) -> tuple[Rotations, Rotations]:
        """Estimate the clean rotations, within ±1, and the logarithm of the variance of a step of the chain."""
        step = torch.from_numpy(chain.indices).to(place.device)[place]
        noise, share = self(noisy, features, step).chunk(2, dim=-1)
        return _clean(noisy, noise, chain, place).clamp(-1.0, 1.0), _log_variance(share, chain, place)

    def loss(self, clean: Rotations, features: Features, step: Steps, noise: Rotations) -> dict[str, Tensor]:
        """Return ``mse`` of the noise, ``vb``, the variational bound in bits, and ``loss``, their sum, of each window.

        Args:
            clean: True rotations.
            features: What the devices say.
            step: Index in the training schedule.
            noise: Standard normal.
        """
        chain = self.schedule
        noisy = noised(clean, chain, step, noise)
        predicted, share = self(noisy, features, step).chunk(2, dim=-1)
        mse = (noise - predicted).square().mean(dim=(1, 2, 3))
        # The bound trains the variance alone: the predicted noise is held fast.
        error = _clean(noisy, predicted.detach(), chain, step) - clean
        error = _at(chain.posterior_mean_clean, step, noisy) * error
        log_variance = _log_variance(share, chain, step)
        above = _log_variance(torch.full_like(share, -1.0), chain, step) - log_variance
        divergence = 0.5 * (above.exp() - 1.0 - above + error.square() * (-log_variance).exp())
        # At the last step the clean values themselves have to be likely.
        unlikely = -_image_log_likelihood(clean, clean + error, log_variance)
        vb = torch.where((step == 0)[:, None, None, None], unlikely, divergence).mean(dim=(1, 2, 3)) / math.log(2.0)
        return {"loss": mse + vb, "mse": mse, "vb": vb}


class _Block(nn.Module):
    """Attention and feed-forward, each normalised, scaled, shifted and gated by what the step says."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.modulation = nn.Linear(width, 6 * width)
        self.norm = nn.LayerNorm(width, eps=1e-6, elementwise_affine=False)
        self.attention = SelfAttention(width, heads, dropout=0.0)
        self.feed_forward = nn.Sequential(nn.Linear(width, width), nn.GELU("tanh"), nn.Linear(width, width))

    def forward(self, stream: Float[Tensor, "windows frames width"], time: Float[Tensor, "windows width"]) -> Tensor:
        shift, scale, gate, late_shift, late_scale, late_gate = self.modulation(time)[:, None].chunk(6, dim=-1)
        stream = stream + gate * self.attention(self.norm(stream) * (1.0 + scale) + shift, None)
        return stream + late_gate * self.feed_forward(self.norm(stream) * (1.0 + late_scale) + late_shift)


class WindowDenoiser(nn.Module):
    """Estimates the clean rotations of a window: the layers of the small denoiser, told the 54 values of each frame."""

    def __init__(self, shape: DiffusionConfiguration) -> None:
        super().__init__()
        width = shape.width
        self.schedule = CosineSchedule(shape.diffusion_steps)
        self.frame_embedding = nn.Linear(22 * 6 + 54, width)
        self.step_embedding = nn.Embedding(shape.diffusion_steps, width)
        layers = range(shape.layers)
        self.layers = nn.ModuleList(FrameLayer(width, shape.heads, 2 * width, dropout=0.0) for _ in layers)
        self.head_norm = nn.LayerNorm(width)
        self.head = from_zero(nn.Linear(width, 22 * 6))  # the first estimate is the T-pose
        self.register_buffer("sinusoid", sinusoid_table(shape.window, width), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Rotations, features: Features, step: Steps) -> Rotations:
        """Estimate the clean rotations."""
        stream = self.frame_embedding(torch.cat((noisy.flatten(2), features), dim=-1))
        stream = stream + self.sinusoid[: noisy.shape[1]]
        told = functional.silu(self.step_embedding(step))
        visible = torch.ones(noisy.shape[:2], dtype=torch.bool, device=noisy.device)
        for layer in self.layers:
            stream = layer(stream, told, visible)
        return noisy.new_tensor(_REST) + self.head(self.head_norm(stream)).unflatten(-1, (22, 6))

    def estimate(self, noisy: Rotations, features: Features, chain: Chain, place: Steps) -> tuple[Rotations, None]:
        """Estimate the clean rotations at a step of the chain; its variance is not learnt."""
        return self(noisy, features, torch.from_numpy(chain.indices).to(place.device)[place]), None


class TrackDiffusion(nn.Module):
    """A network of a configuration with what training and tracker ask of it."""

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        network = BoDiffusion if configuration.network == "published" else WindowDenoiser
        self.denoiser = network(configuration)

    def losses(self, batch: TrackWindows, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the losses of windows by name, at a random step of each."""
        clean = batch.rotations
        step = torch.randint(self.configuration.diffusion_steps, (len(clean),), generator=generator).to(clean.device)
        noise = torch.randn(clean.shape, generator=generator).to(clean)
        if isinstance(self.denoiser, BoDiffusion):
            return {name: each.mean() for name, each in self.denoiser.loss(clean, batch.features, step, noise).items()}
        predicted = self.denoiser(noised(clean, self.denoiser.schedule, step, noise), batch.features, step)
        both = matrices_of_columns(torch.stack((predicted, clean)))
        found, recorded = joints_under_head(both, batch.offsets[:, None], batch.head.expand(2, -1, -1, -1))
        rotations = functional.l1_loss(predicted, clean)
        positions = functional.l1_loss(found, recorded)
        velocities = functional.l1_loss(found.diff(dim=1), recorded.diff(dim=1)) * self.configuration.fps
        loss = rotations + positions + _VELOCITY_WEIGHT * velocities
        return {"loss": loss, "rotations": rotations, "positions": positions, "velocities": velocities}

    @torch.no_grad()
    def rotations(self, rows: Float[Tensor, "frames 54"], seed: int) -> Float[Tensor, "frames 22 3 3"]:
        """Draw the local rotations of every frame of a track, the root's in the world.

        Args:
            rows: Values of the track (:func:`~prbench_adapters.three_points.features.track_values`); the head is known
                in every frame.
            seed: Decides alone what is drawn.
        """
        shape = self.configuration
        places = window_places(len(rows), shape.window, shape.slide).to(rows.device)
        features, turn, _ = in_head_frame(rows[places])
        generator = sequence_generator(seed)

        def noise() -> Track:
            return torch.from_numpy(generator.standard_normal((len(rows), 22, 6), dtype=np.float32)).to(rows)

        return matrices_of_columns(sample(self.denoiser, features, places, noise, shape.sampling_steps, turn))


def sample(
    network: BoDiffusion | WindowDenoiser,
    features: Features,
    places: Int[Tensor, "windows length"],
    noise: Callable[[], Track],
    steps: int,
    turn: Turns,
) -> Track:
    """Walk from noise to the rotations of a whole track; in each step its windows are denoised and averaged.

    BoDiffusion's steps draw from the posterior, and all windows count alike. Ours are deterministic, and a window
    counts the less the nearer a frame lies to its ends, so that the average does not jump where a window begins.

    Args:
        network: The network, in evaluation mode.
        features: What the devices say in each window.
        places: The frames of each window (:func:`window_places`), which cover the track.
        noise: Draws standard normal noise of the whole track: to start from, and for each step that adds some.
        steps: How many steps of the training schedule are taken.
        turn: Turns the root of each window into the track's world.
    """
    published = isinstance(network, BoDiffusion)
    chain = network.schedule.chain(steps, "trailing")
    of_clean, of_state = chain.posterior_mean_clean, chain.posterior_mean_noisy
    state = noise()
    weight = state.new_ones(places.shape[1])
    if not published:
        of_clean, of_state = ddim_factors(chain.alphas_cumprod, chain.alphas_cumprod_previous)
        state = _START_SCALE * state
        weight = weight.cumsum(0)
        weight = torch.minimum(weight, weight.flip(0))

    def joined(values: Float[Tensor, "windows length *shape"]) -> Tensor:
        total = values.new_zeros(len(state), *values.shape[2:])
        return total.index_add(0, places.flatten(), (values * weight[:, None, None]).flatten(0, 1))

    count = joined(state.new_ones(*places.shape, 1, 1))
    for place in range(len(chain) - 1, -1, -1):
        noisy = turned(state[places], turn.mT)
        here = torch.full((len(places),), place, device=state.device)
        clean, log_variance = network.estimate(noisy, features, chain, here)
        clean = joined(turned(clean, turn)) / count
        state = float(of_clean[place]) * clean + float(of_state[place]) * state
        if log_variance is not None and place >= _NOISE_FREE:
            # Variances of numbers that are independent turn by the squares of the matrix.
            variance = turned(log_variance.exp(), turn.square())
            state = state + joined(variance).sqrt() / count * noise()
    return state


def window_places(frames: int, window: int, slide: int) -> Int[Tensor, "windows length"]:
    """Return the frames of windows that cover a track: one every ``slide`` frames, and one that ends with the track."""
    length = min(window, frames)
    starts = np.unique(np.minimum(np.arange(0, frames, slide), frames - length))
    return torch.from_numpy(starts[:, None] + np.arange(length))


def turned(rotations: Rotations, by: Turns) -> Rotations:
    """Return rotations with the root of each window turned; so normal noise stays what it is."""
    columns = rotations[..., 0, :].unflatten(-1, (2, 3))
    root = (columns @ by[:, None].mT).flatten(-2)
    return torch.cat((root[..., None, :], rotations[..., 1:, :]), dim=-2)


def noised(clean: Rotations, chain: Chain, step: Steps, noise: Rotations) -> Rotations:
    """Return the state of a step of the chain, given standard normal noise."""
    level = chain.alphas_cumprod
    return _at(level**0.5, step, noise) * clean + _at((1.0 - level) ** 0.5, step, noise) * noise


def _at(values: Float[np.ndarray, " steps"], place: Steps, like: Tensor) -> Float[Tensor, "windows 1 1 1"]:
    return torch.from_numpy(values).to(like)[place][:, None, None, None]


def _clean(noisy: Rotations, noise: Rotations, chain: Chain, place: Steps) -> Rotations:
    level = chain.alphas_cumprod
    return _at(level**-0.5, place, noisy) * noisy - _at((1.0 / level - 1.0) ** 0.5, place, noisy) * noise


def _log_variance(share: Rotations, chain: Chain, place: Steps) -> Rotations:
    """Logarithm of the variance of a step, between its smallest for a share of -1 and its largest for 1."""
    smallest = chain.posterior_variance.copy()
    smallest[0] = smallest[1]  # the last step has none and takes its neighbour's
    least, most = (_at(np.log(variance), place, share) for variance in (smallest, chain.betas))
    return torch.lerp(least, most, 0.5 * (share + 1.0))


def _image_log_likelihood(value: Tensor, mean: Tensor, log_variance: Tensor) -> Tensor:
    """Logarithm of the probability of an 8-bit number within ±1; the outermost bins have no end."""
    precision = (-0.5 * log_variance).exp()
    above = _normal_below((value - mean + _HALF_BIN) * precision)
    below = _normal_below((value - mean - _HALF_BIN) * precision)
    above = torch.where(value > _LAST_BIN, 1.0, above)
    below = torch.where(value < -_LAST_BIN, 0.0, below)
    return (above - below).clamp_min(1e-12).log()


def _normal_below(value: Tensor) -> Tensor:
    """Approximate the share of a standard normal distribution below a value, as published."""
    return 0.5 * (1.0 + torch.tanh(math.sqrt(2.0 / math.pi) * (value + 0.044715 * value**3)))
