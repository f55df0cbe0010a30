"""A small network whose frames know how long it is to the start and the end, and where the goal is.

Ours, for small models (``architecture = "frames"``; docs/methods/pr.md), with three changes to the study's decoder.
Condition, text and diffusion step are added to every frame token in every layer, where the decoder reaches them through
attention. A token knows its time before the end as well as its time since the start. Half-way through, the network
decodes an estimate of the motion and is shown where the goal is from its head and wrists, which noisy input does not
tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.denoiser import frame_mask, pooled
from prbench_adapters.diffusion.goal_frame import N_SIGHT, GoalFrame, sight
from prbench_adapters.diffusion.layers import sinusoid_table


class _Layer(nn.Module):
    """Self-attention and feed-forward, each normalised before and added to the stream; the condition is added first."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.condition = nn.Linear(width, width)
        self.attention_norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width)
        self.output = nn.Linear(width, width)
        self.feed_forward_norm = nn.LayerNorm(width)
        self.expand = nn.Linear(width, hidden)
        self.contract = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)

    def forward(
        self,
        stream: Float[Tensor, "batch tokens width"],
        condition: Float[Tensor, "batch width"],
        visible: Bool[Tensor, "batch 1 1 tokens"] | None,
    ) -> Float[Tensor, "batch tokens width"]:
        stream = stream + self.condition(condition)[:, None]
        stream = stream + self.dropout(self._attended(self.attention_norm(stream), visible))
        hidden = functional.gelu(self.expand(self.feed_forward_norm(stream)), approximate="tanh")
        return stream + self.dropout(self.contract(hidden))

    def _attended(self, stream: Tensor, visible: Tensor | None) -> Tensor:
        parts = self.query_key_value(stream).chunk(3, dim=-1)
        query, key, value = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts)
        # Written out: for so few tokens it takes a third of the time of the fused kernels of processors.
        scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
        if visible is not None:
            scores = scores.masked_fill(~visible, -math.inf)
        return self.output((scores.softmax(dim=-1) @ value).transpose(1, 2).flatten(2))


@dataclass(frozen=True)
class PreparedFrames:
    """Everything that a pass takes from condition and step."""

    condition: Float[Tensor, "batch width"]
    frame: GoalFrame


class FrameDenoiser(nn.Module):
    """Estimates the clean goal-frame features from noisy ones, the step, and the condition.

    Args:
        configuration: Of ``features = "goal-frame"``.
        mean: Of the features (66,), with which those of the network are standardised.
        std: Likewise.
    """

    def __init__(self, configuration: DenoiserConfiguration, mean: Tensor, std: Tensor) -> None:
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
        self.estimate_norm = nn.LayerNorm(width)
        self.estimate = nn.Linear(width, numbers)
        self.sight_embedding = nn.Linear(N_SIGHT * configuration.frames_per_token, width)
        self.head_norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, numbers)
        for layer in (self.estimate, self.head):  # the first estimate is the mean motion
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
        # A token's time counts in frames; two zeros of padding are the longest motion's last token.
        self.register_buffer("sinusoid", sinusoid_table(configuration.max_frames + 1, width), persistent=False)
        self.register_buffer("mean", mean, persistent=False)
        self.register_buffer("std", std, persistent=False)
        self.sinusoid: Tensor
        self.mean: Tensor
        self.std: Tensor

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

    def prepare(self, condition: EncodedCondition, step: Int[Tensor, " rows"]) -> PreparedFrames:
        """The part of :meth:`forward` that depends on condition and step; ``step`` has one entry a row, or one for all.

        Raises:
            ValueError: if the condition has no vector.
        """
        if condition.vector is None or condition.given is None:
            raise ValueError(f"a denoiser with goal '{self.configuration.goal}' needs a condition vector")
        text = pooled(condition.text, condition.padding)[:, 0]
        told = self.condition_embedding(torch.cat((condition.vector, text), dim=1))
        told = functional.silu(told + self.step_embedding(step))
        return PreparedFrames(told, GoalFrame.of(condition.given))

    def denoise(
        self,
        noisy: Float[Tensor, "batch frames features"],
        prepared: PreparedFrames,
        visible: Bool[Tensor, "batch frames"] | None,
    ) -> Float[Tensor, "batch frames features"]:
        """The part of :meth:`forward` that depends on the noisy features; ``visible`` is :func:`frame_mask`'s."""
        return self.estimates(noisy, prepared, visible)[1]

    def estimates(
        self,
        noisy: Float[Tensor, "batch frames features"],
        prepared: PreparedFrames,
        visible: Bool[Tensor, "batch frames"] | None,
    ) -> tuple[Float[Tensor, "batch frames features"], Float[Tensor, "batch frames features"]]:
        """The estimate half-way through the layers, and the one at their end."""
        frames = noisy.shape[1]
        if visible is None:
            visible = torch.ones(noisy.shape[:2], dtype=torch.bool, device=noisy.device)
        n_frames = visible.sum(dim=1)
        stream = self.frame_embedding(self._tokens(noisy, visible)) + self._times(frames, n_frames)
        keys = self._tokens(visible[..., None], visible).any(dim=2)[:, None, None]
        half = len(self.layers) // 2
        for layer in self.layers[:half]:
            stream = layer(stream, prepared.condition, keys)
        estimate = self._frames(self.estimate(self.estimate_norm(stream)), frames)
        seen = self._sight(estimate, prepared.frame, n_frames)
        stream = stream + self.sight_embedding(self._tokens(seen, visible).to(stream.dtype))
        for layer in self.layers[half:]:
            stream = layer(stream, prepared.condition, keys)
        return estimate, estimate + self._frames(self.head(self.head_norm(stream)), frames)

    def _sight(self, estimate: Tensor, frame: GoalFrame, n_frames: Tensor) -> Float[Tensor, "batch frames sight"]:
        """What the goal looks like from an estimated body."""
        with torch.autocast(estimate.device.type, enabled=False):  # centimetres are lost in bfloat16
            features = estimate.to(self.mean.dtype) * self.std + self.mean
            joints = frame.in_goal_frame(features, n_frames, self.configuration.fps)
            return sight(joints, frame.height)

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

    def _frames(self, tokens: Tensor, frames: int) -> Float[Tensor, "batch frames features"]:
        """Undo :meth:`_tokens`."""
        return tokens.unflatten(-1, (self.configuration.frames_per_token, -1)).flatten(1, 2)[:, :frames]
