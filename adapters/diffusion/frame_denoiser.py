"""A small network whose frames know how long it is to the start and the end, and where the goal is.

Ours, for small models (``architecture = "frames"``; docs/methods/pr.md), with two changes to the study's decoder.
Condition, text and diffusion step are added to every frame token in every layer, where the decoder reaches them through
attention; and a token knows its time before the end as well as its time since the start.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import frame_mask, pooled
from prbench_adapters.diffusion.layers import sinusoid_table

_NEIGHBOURS = 2  # tokens before and after


class _Layer(nn.Module):
    """Self-attention and feed-forward, each normalised before and added to the stream; the condition is added first.

    Before the feed-forward part each number of a token takes in those of its :data:`_NEIGHBOURS` neighbours, by weights
    that start at zero: motion is local in time, which attention would first have to learn.
    """

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.condition = nn.Linear(width, width)
        self.attention_norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.output = nn.Linear(width, width)
        self.feed_forward_norm = nn.LayerNorm(width)
        self.neighbours = nn.Parameter(torch.zeros(2 * _NEIGHBOURS + 1, width))
        self.expand = nn.Linear(width, hidden)
        self.contract = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)

    def forward(
        self,
        stream: Float[Tensor, "batch tokens width"],
        condition: Float[Tensor, "batch width"],
        visible: Bool[Tensor, "batch tokens"],
    ) -> Float[Tensor, "batch tokens width"]:
        stream = stream + self.condition(condition)[:, None]
        stream = stream + self.dropout(self._attended(self.attention_norm(stream), visible))
        around = self._with_neighbours(self.feed_forward_norm(stream) * visible[..., None])
        hidden = functional.gelu(self.expand(around), approximate="tanh")
        return stream + self.dropout(self.contract(hidden))

    def _with_neighbours(self, stream: Tensor) -> Tensor:
        padded = functional.pad(stream, (0, 0, _NEIGHBOURS, _NEIGHBOURS))
        for place, weight in enumerate(self.neighbours):
            stream = stream + weight * padded[:, place : place + stream.shape[1]]
        return stream

    def _attended(self, stream: Tensor, visible: Tensor) -> Tensor:
        parts = self.query_key_value(stream).chunk(3, dim=-1)
        query, key, value = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts)
        # Written out: for so few tokens it takes a third of the time of the fused kernels of processors.
        scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
        scores = scores.masked_fill(~visible[:, None, None], -math.inf)
        return self.output((scores.softmax(dim=-1) @ value).transpose(1, 2).flatten(2))


class FrameDenoiser(nn.Module):
    """Estimates the clean goal-frame features from noisy ones, the step, and the condition.

    Args:
        configuration: Of ``features = "goal-frame"``.
    """

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.width
        numbers = configuration.n_features * configuration.frames_per_token
        self.frame_embedding = nn.Linear(numbers, width)
        self.condition_embedding = nn.Sequential(
            nn.Linear(configuration.condition_size + configuration.text_dimension, 2 * width),
            nn.SiLU(),
            nn.Linear(2 * width, width),
        )
        self.step_embedding = nn.Embedding(configuration.diffusion_steps, width)
        self.time_to_end = nn.Linear(width, width)
        self.layers = nn.ModuleList(
            _Layer(width, configuration.heads, configuration.feed_forward, configuration.dropout)
            for _ in range(configuration.layers)
        )
        self.head_norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, numbers)
        nn.init.zeros_(self.head.weight)  # the first estimate is the mean motion
        nn.init.zeros_(self.head.bias)
        self.register_buffer("sinusoid", sinusoid_table(configuration.max_frames + 1, width), persistent=False)
        self.sinusoid: Tensor

    def forward(
        self,
        noisy: Float[Tensor, "batch frames features"],
        step: Int[Tensor, " batch"],
        condition: EncodedCondition,
        n_frames: Int[Tensor, " batch"],
    ) -> Float[Tensor, "batch frames features"]:
        """Estimate the clean features; the arguments are those of :class:`~.denoiser.Denoiser`."""
        visible = frame_mask(n_frames, noisy.shape[1], noisy.device)
        return self.denoise(noisy, self.prepare(condition, step), visible)

    @torch.no_grad()
    def take_steps(self, other: FrameDenoiser, steps: Int[Tensor, " kept"]) -> None:
        """Take over the weights of another denoiser, whose steps ``steps`` become the steps 0, 1, … here."""
        weights = other.state_dict()
        weights["step_embedding.weight"] = weights["step_embedding.weight"][steps]
        self.load_state_dict(weights)

    def prepare(self, condition: EncodedCondition, step: Int[Tensor, " rows"]) -> Float[Tensor, "batch width"]:
        """The part of :meth:`forward` that depends on condition and step; ``step`` has one entry a row, or one for all.

        Raises:
            ValueError: if the condition has no vector.
        """
        if condition.vector is None:
            raise ValueError(f"a denoiser with goal '{self.configuration.goal}' needs a condition vector")
        text = pooled(condition.text, condition.padding)[:, 0]
        told = self.condition_embedding(torch.cat((condition.vector, text), dim=1))
        return functional.silu(told + self.step_embedding(step))

    def denoise(
        self,
        noisy: Float[Tensor, "batch frames features"],
        prepared: Float[Tensor, "batch width"],
        visible: Bool[Tensor, "batch frames"] | None,
    ) -> Float[Tensor, "batch frames features"]:
        """The part of :meth:`forward` that depends on the noisy features; ``visible`` is :func:`frame_mask`'s."""
        frames = noisy.shape[1]
        if visible is None:
            visible = torch.ones(noisy.shape[:2], dtype=torch.bool, device=noisy.device)
        stream = self.frame_embedding(self._tokens(noisy, visible)) + self._times(frames, visible.sum(dim=1))
        shown = self._tokens(visible[..., None], visible).any(dim=2)
        for layer in self.layers:
            stream = layer(stream, prepared, shown)
        clean = self.head(self.head_norm(stream))
        return clean.unflatten(-1, (self.configuration.frames_per_token, -1)).flatten(1, 2)[:, :frames]

    def _times(self, frames: int, n_frames: Int[Tensor, " batch"]) -> Float[Tensor, "batch tokens width"]:
        """Embeddings of each token's time since the start and before the end."""
        start = torch.arange(0, frames, self.configuration.frames_per_token, device=n_frames.device)
        left = (n_frames[:, None] - 1 - start).clamp_min(0)
        return self.sinusoid[start] + self.time_to_end(self.sinusoid[left])

    def _tokens(self, values: Tensor, visible: Bool[Tensor, "batch frames"]) -> Tensor:
        """Join the frames of each token; padded frames are zeros."""
        together = self.configuration.frames_per_token
        values = values.masked_fill(~visible[..., None], 0)
        missing = -values.shape[1] % together
        return functional.pad(values, (0, 0, 0, missing)).unflatten(1, (-1, together)).flatten(2)
