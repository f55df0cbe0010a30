"""BeLFusion: diffusion of behaviours, each of which is then decoded from the last observed frames.

Source: docs/specification/prediction-baselines.md#belfusion. The autoencoders of behaviour, the U-Net over latents, and
the sampling. Joints are in metres.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Literal

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import weight_norm

from prbench_adapters.diffusion.denoiser import from_zero, sinusoid_table
from prbench_adapters.diffusion.sampling import Chain, ddim_factors
from prbench_adapters.prediction import recurrent

Motion = Float[Tensor, "windows frames joints 3"]
Behaviour = Float[Tensor, "windows behaviour"]
Behaviours = Float[Tensor, "windows samples behaviour"]
Past = Float[Tensor, "windows past"]
Steps = Int[Tensor, " windows"]
Image = Float[Tensor, "batch channels height width"]

_GROUPS = 32
_Resize = Literal["none", "halve", "double"]
_OFFSET = 1e-4
_LARGEST_BETA = 0.999


class UNetConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the U-Net.

    Attributes:
        multiples: Channels of each level, in ``channels``; every further level halves height and width.
        attention_at: Reductions of the resolution at which blocks are followed by attention.
        condition: Numbers of the code of the past.

    Raises:
        ValueError: for sizes that do not fit together.
    """

    height: int = 16
    width: int = 8
    channels: int = 32
    multiples: tuple[int, ...] = (1, 2, 4, 8)
    attention_at: tuple[int, ...] = (4, 8)
    head_channels: int = 16
    condition: int = 64
    steps: int = 10

    def __post_init__(self) -> None:
        if self.channels < 1 or self.channels % _GROUPS or not self.multiples or min(self.multiples) < 1:
            found = f"{self.channels} and {list(self.multiples)}"
            raise ValueError(f"'channels' must be a multiple of {_GROUPS} and 'multiples' positive, found {found}")
        stride = 2 ** (len(self.multiples) - 1)
        if min(self.height, self.width) < 1 or self.height % stride or self.width % stride:
            why = f"because the levels halve them, found {self.height} and {self.width}"
            raise ValueError(f"'height' and 'width' must be multiples of {stride}, {why}")
        if self.head_channels < 1 or self.channels % self.head_channels:
            raise ValueError(f"'head_channels' must divide {self.channels} channels, found {self.head_channels}")
        if self.condition < 1 or self.steps < 1:
            raise ValueError(f"'condition' and 'steps' must be at least 1, found {self.condition} and {self.steps}")

    @property
    def latent(self) -> int:
        """Numbers of the latent vector."""
        return self.height * self.width


class LatentUNet(nn.Module):
    """Predicts the clean latent vector from a noisy one, the step and the code of the past.

    Args:
        configuration: Sizes.
    """

    def __init__(self, configuration: UNetConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        channels = configuration.channels
        time = 4 * channels
        self.time = nn.Sequential(nn.Linear(channels, time), nn.SiLU(), nn.Linear(time, time))
        self.input = nn.Conv2d(1, channels, 3, padding=1)
        widths = [channels * multiple for multiple in configuration.multiples]
        embedding = time + configuration.condition
        last = len(widths) - 1
        skips, inputs = [channels], channels
        self.down = nn.ModuleList()
        for level, width in enumerate(widths):
            self.down.append(nn.ModuleList([_Block(inputs, width, embedding), *self._attention(level, width)]))
            skips.append(width)
            if level < last:
                self.down.append(nn.ModuleList([_Block(width, width, embedding, "halve")]))
                skips.append(width)
            inputs = width
        block = partial(_Block, inputs, inputs, embedding)
        self.middle = nn.ModuleList([block(), _Attention(inputs, configuration.head_channels), block()])
        self.up = nn.ModuleList()
        for level, width in reversed(list(enumerate(widths))):
            # A level has as many blocks on the way up as outputs on the way down: its own, and that of the change.
            for place in range(2):
                stage = [_Block(inputs + skips.pop(), width, embedding), *self._attention(level, width)]
                if place and level:
                    stage.append(_Block(width, width, embedding, "double"))
                self.up.append(nn.ModuleList(stage))
                inputs = width
        output = from_zero(nn.Conv2d(inputs, 1, 3, padding=1))
        self.output = nn.Sequential(nn.GroupNorm(_GROUPS, inputs), nn.SiLU(), output)
        table = sinusoid_table(configuration.steps, channels)
        self.register_buffer("sinusoid", torch.cat([table[:, 1::2], table[:, ::2]], dim=1), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Behaviour, step: Steps, condition: Past) -> Behaviour:
        """Predict; ``step`` is the index in the training schedule."""
        embedding = functional.silu(torch.cat([self.time(self.sinusoid[step]), condition], dim=1))
        shape = self.configuration
        stream = self.input(noisy.view(-1, 1, shape.height, shape.width))
        skips = [stream]
        for stage in self.down:
            stream = _through(stage, stream, embedding)
            skips.append(stream)
        stream = _through(self.middle, stream, embedding)
        for stage in self.up:
            stream = _through(stage, torch.cat([stream, skips.pop()], dim=1), embedding)
        return self.output(stream).flatten(1)

    def _attention(self, level: int, width: int) -> list[nn.Module]:
        if 2**level not in self.configuration.attention_at:
            return []
        return [_Attention(width, self.configuration.head_channels)]


def _through(stage: nn.Module, stream: Tensor, embedding: Tensor) -> Tensor:
    for part in stage.children():
        stream = part(stream, embedding)
    return stream


class _Block(nn.Module):
    """Two convolutions beside a skip; step and condition scale and shift what stands between them."""

    def __init__(self, inputs: int, outputs: int, embedding: int, resize: _Resize = "none") -> None:
        super().__init__()
        self.resize = resize
        self.first_norm = nn.GroupNorm(_GROUPS, inputs)
        self.first = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.scale_shift = nn.Linear(embedding, 2 * outputs)
        self.second_norm = nn.GroupNorm(_GROUPS, outputs)
        self.second = from_zero(nn.Conv2d(outputs, outputs, 3, padding=1))
        self.skip = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, stream: Image, embedding: Tensor) -> Tensor:
        hidden = self.first(self._resized(functional.silu(self.first_norm(stream))))
        scale, shift = self.scale_shift(embedding)[:, :, None, None].chunk(2, dim=1)
        hidden = torch.addcmul(shift, self.second_norm(hidden), 1 + scale)
        return self.skip(self._resized(stream)) + self.second(functional.silu(hidden))

    def _resized(self, stream: Tensor) -> Tensor:
        if self.resize == "halve":
            return functional.avg_pool2d(stream, 2)
        if self.resize == "double":
            return functional.interpolate(stream, scale_factor=2, mode="nearest")
        return stream


class _Attention(nn.Module):
    """Self-attention of all places of the image, residual."""

    def __init__(self, channels: int, head_channels: int) -> None:
        super().__init__()
        self.heads = channels // head_channels
        self.norm = nn.GroupNorm(_GROUPS, channels)
        self.query_key_value = nn.Conv1d(channels, 3 * channels, 1)
        self.output = from_zero(nn.Conv1d(channels, channels, 1))

    def forward(self, stream: Image, embedding: Tensor) -> Image:  # noqa: ARG002 - called like a block
        """Let each place of the stream look at all others; the embedding of the diffusion step has no part in it."""
        places = self.query_key_value(self.norm(stream).flatten(2))
        query, key, value = places.unflatten(1, (3, self.heads, -1)).movedim(1, 0).transpose(-1, -2)
        attended = functional.scaled_dot_product_attention(query, key, value)
        return stream + self.output(attended.transpose(-1, -2).flatten(1, 2)).view_as(stream)


class BehaviourConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of both autoencoders and weights of the losses; the defaults are those of H36M.

    Attributes:
        context: Last observed frames that a behaviour is joined to, and that belong to what it describes.
        past: Width of the code of the past.
        offsets_summed: Whether decoded offsets of the past are summed over frames, or added to the first pose.
        beta: Weight of the divergence from the prior.
        delta: Weight of the auxiliary decoder's error, which the behaviour is to make large: it shall not hold poses.

    Raises:
        ValueError: for sizes below 1.
    """

    n_joints: int
    observed: int = 15
    predicted: int = 60
    context: int = 3
    past: int = 64
    mlp: tuple[int, ...] = (300, 200)
    offsets_summed: bool = True
    behaviour: int = 128
    decoder: int = 128
    context_width: int = 128
    beta: float = 1e-4
    delta: float = 1.05

    def __post_init__(self) -> None:
        sizes = ("n_joints", "observed", "predicted", "context", "past", "behaviour", "decoder", "context_width")
        recurrent.require_sizes(self, *sizes)
        if self.context > self.observed:
            raise ValueError(f"'context' must be at most the {self.observed} observed frames, found {self.context}")

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
        self.decoder = recurrent.PoseDecoder(past, past, past, configuration.mlp, values)

    def code(self, observed: Motion) -> Past:
        """Return the code of observed frames in metres."""
        return recurrent.last_state(self.encoder, observed.flatten(2))

    def forward(self, motion: Motion) -> Motion:
        """Return the first frame as it is, and the others from their code."""
        frames = motion.flatten(2)
        start = frames[:, 0]
        code = self.code(motion[:, 1:])
        offsets = self.decoder(code, code, start, frames.shape[1] - 1)
        if self.configuration.offsets_summed:
            offsets = offsets.cumsum(dim=1)
        return torch.cat([frames[:, :1], start[:, None] + offsets], dim=1).unflatten(-1, (-1, 3))

    def loss(self, motion: Motion) -> Float[Tensor, ""]:
        """Mean squared error of all frames, m²."""
        return (self(motion) - motion).square().mean()


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

    def encode(self, sequence: Motion) -> tuple[Behaviour, Behaviour]:
        """Mean and logarithm of the deviation of the behaviour of context and future."""
        hidden = recurrent.last_state(self.encoder, sequence.flatten(2))
        return self.mean(hidden), self.log_deviation(hidden)

    def draw(self, sequence: Motion, noise: Behaviour) -> Behaviour:
        """One behaviour a window, from standard normal noise; published evaluation draws it too."""
        mean, log_deviation = self.encode(sequence)
        return mean + log_deviation.exp() * noise

    def decode(self, context: Motion, behaviour: Behaviours) -> recurrent.Futures:
        """Futures that go on from the context, which is encoded once a window."""
        samples = behaviour.shape[1]
        flat = context.flatten(2)
        told = self.context(flat.flatten(1))[:, None].expand(-1, samples, -1)
        steps = torch.cat([behaviour, told], dim=2).flatten(0, 1)
        steps = steps[:, None].expand(-1, self.configuration.predicted, -1)
        offsets = self.offset(self.coupler(steps)[0]).unflatten(0, (-1, samples))
        return (flat[:, None, -1:] + offsets).unflatten(-1, (-1, 3))

    def decode_without_context(self, behaviour: Behaviour) -> Motion:
        """Return what the auxiliary decoder can tell of context and future from the behaviour alone."""
        steps = behaviour[:, None].expand(-1, self.configuration.context + self.configuration.predicted, -1)
        return self.auxiliary_pose(self.auxiliary(steps)[0]).unflatten(-1, (-1, 3))

    def loss(self, sequence: Motion, noise: Behaviour, *, coupler_alone: bool = False) -> recurrent.Losses:
        """Return the published losses of encoder, coupler and auxiliary decoder in one, m² a window.

        Args:
            sequence: Context and future.
            noise: Standard normal.
            coupler_alone: Encoder and auxiliary decoder stay as they are.

        Returns:
            ``loss`` and its parts; with ``coupler_alone`` of the reconstruction alone.
        """
        n = len(sequence)
        context, future = sequence.split([self.configuration.context, self.configuration.predicted], dim=1)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not coupler_alone):
            mean, log_deviation = self.encode(sequence)
            behaviour = mean + log_deviation.exp() * noise
        squared_error = (self.decode(context, behaviour[:, None])[:, 0] - future).square().sum() / n
        if coupler_alone:
            return {"loss": squared_error, "squared_error": squared_error}
        # The published program puts the logarithm of the deviation where that of the variance belongs.
        kl = recurrent.gaussian_kl(mean, log_deviation).sum() / n
        # The same number as `behaviour`, of whose gradient 1 - delta goes on: the auxiliary decoder learns from its
        # whole error, and the encoder from what the published program leaves of it, which makes it hide the poses.
        hidden = behaviour.detach() + (1.0 - self.configuration.delta) * (behaviour - behaviour.detach())
        auxiliary = (self.decode_without_context(hidden) - sequence).square().sum() / n
        total = squared_error + self.configuration.beta * kl + auxiliary
        return {"loss": total, "squared_error": squared_error, "kl": kl, "auxiliary": auxiliary}


class _ScaledLinear(nn.Module):
    """γ ⊙ (g v/‖v‖ · p + c) + β for each row."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.linear = weight_norm(nn.Linear(size, size))
        self.scale = nn.Parameter(torch.ones(size))
        self.shift = nn.Parameter(torch.zeros(size))

    def forward(self, hidden: Behaviour) -> Behaviour:
        return self.scale * self.linear(hidden) + self.shift


class BeLFusion(nn.Module):
    """Both autoencoders, trained before and frozen here, and the diffusion of scaled behaviours.

    Args:
        behaviour: Sizes of the autoencoders.
        unet: Sizes of the denoiser.
        decoded_weight: Weight of the decoded future in the loss.

    Raises:
        ValueError: if the sizes of the parts do not fit.
    """

    def __init__(
        self, behaviour: BehaviourConfiguration, unet: UNetConfiguration, *, decoded_weight: float = 5.0
    ) -> None:
        super().__init__()
        if unet.latent != behaviour.behaviour or unet.condition != behaviour.past:
            raise ValueError(
                f"the U-Net is made for behaviours of {unet.latent} and codes of {unet.condition} numbers, the"
                f" autoencoders for {behaviour.behaviour} and {behaviour.past}"
            )
        self.configuration, self.decoded_weight = behaviour, decoded_weight
        self._context_start = behaviour.observed - behaviour.context
        self.past = PastAutoencoder(behaviour).requires_grad_(False)
        self.behaviour = BehaviourAutoencoder(behaviour).requires_grad_(False)
        self.denoiser = LatentUNet(unet)
        # β_i = min(1 - f((i + 1)/T)/f(i/T), 0.999) with f(s) = max(0, 1 - √(s + 0.0001)).
        level = np.maximum(0.0, 1.0 - np.sqrt(np.arange(unet.steps + 1) / unet.steps + _OFFSET))
        betas = np.minimum(1.0 - level[1:] / level[:-1], _LARGEST_BETA)
        self.schedule = Chain(np.arange(unet.steps), np.cumprod(1.0 - betas))
        for name, size in (("past", behaviour.past), ("behaviour", behaviour.behaviour)):
            self.register_buffer(f"{name}_min", -torch.ones(size))
            self.register_buffer(f"{name}_max", torch.ones(size))
        self.past_min: Tensor
        self.past_max: Tensor
        self.behaviour_min: Tensor
        self.behaviour_max: Tensor

    def condition(self, observed: recurrent.Observed) -> Past:
        """Return the code of the past, ±1 over the training windows."""
        return _scaled(self.past.code(observed), self.past_min, self.past_max)

    def target(self, motion: Motion, noise: Behaviour) -> Behaviour:
        """Return the behaviour of whole windows, drawn with standard normal noise, ±1 over the training windows."""
        drawn = self.behaviour.draw(motion[:, self._context_start :], noise)
        return _scaled(drawn, self.behaviour_min, self.behaviour_max)

    def decode(self, observed: recurrent.Observed, latent: Behaviours) -> recurrent.Futures:
        """Futures of scaled behaviours."""
        behaviour = (latent + 1.0) / 2.0 * (self.behaviour_max - self.behaviour_min) + self.behaviour_min
        return self.behaviour.decode(observed[:, self._context_start :], behaviour)

    def denoised(self, noisy: Behaviours, step: Steps, condition: Past) -> Behaviours:
        """Clean behaviours of noisy ones."""
        samples = noisy.shape[1]
        told, steps = condition.repeat_interleave(samples, dim=0), step.repeat_interleave(samples)
        return self.denoiser(noisy.flatten(0, 1), steps, told).unflatten(0, (-1, samples))

    def loss(
        self, motion: Motion, step: Steps, noise: Behaviours, behaviour_noise: Behaviour
    ) -> dict[str, Float[Tensor, " windows"]]:
        """Errors of the best of several noises at one step, of each window: of the latent vector and of the future.

        Args:
            motion: Whole windows.
            step: Index in the training schedule, 0 … T - 1.
            noise: Standard normal, for each sample.
            behaviour_noise: Standard normal, for the behaviour that is to be found.
        """
        observed = motion[:, : self.configuration.observed]
        with torch.no_grad():
            condition = self.condition(observed)
            target = self.target(motion, behaviour_noise)[:, None]
            decoded_target = self.decode(observed, target).flatten(2)
        level = torch.from_numpy(self.schedule.alphas_cumprod).to(noise)[step][:, None, None]
        clean = self.denoised(level.sqrt() * target + (1.0 - level).sqrt() * noise, step, condition)
        latent = (clean - target).abs().sum(dim=-1).amin(dim=1)
        decoded = (self.decode(observed, clean).flatten(2) - decoded_target).norm(dim=-1).amin(dim=1)
        return {"loss": latent + self.decoded_weight * decoded, "latent": latent, "decoded": decoded}

    @torch.no_grad()
    def predict(self, observed: recurrent.Observed, seeds: recurrent.Seeds) -> recurrent.Futures:
        """Draw continuations."""
        start = recurrent.latent_noise(seeds, self.configuration.behaviour, observed)
        *_, (_, clean) = self.states(start, self.condition(observed))
        return self.decode(observed, clean)

    @torch.no_grad()
    def states(self, start: Behaviours, condition: Past) -> Iterator[tuple[Behaviours, Behaviours]]:
        """Walk from noise to behaviours by DDIM (η = 0), the noisiest step first.

        Yields:
            The state after each step, and the clean estimate within ±1 that it was made from; those of the last step
            are equal.
        """
        of_clean, of_state = ddim_factors(self.schedule.alphas_cumprod, self.schedule.alphas_cumprod_previous)
        state = start
        for index in reversed(range(len(self.schedule))):
            step = torch.full((len(start),), index, device=start.device)
            clean = self.denoised(state, step, condition).clamp(-1.0, 1.0)
            state = float(of_clean[index]) * clean + float(of_state[index]) * state
            yield state, clean


def _scaled(values: Tensor, smallest: Tensor, largest: Tensor) -> Tensor:
    return 2.0 * (values - smallest) / (largest - smallest) - 1.0
