"""The transformer over DCT coefficients that predicts noise: GazeMoDiff's, and without cross-attention HumanMAC's.

Sources: docs/specification/gazemodiff.md#network, docs/specification/prediction-baselines.md#humanmac.

Streams have the axes (windows, samples, coefficients, width): what belongs to a window is computed once for all of its
samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench_adapters.diffusion.layers import sinusoid_table
from prbench_adapters.prediction.configuration import DiffusionConfiguration

_Memory = tuple[Tensor, Tensor]
"""What a stream is multiplied with for the scores of all heads, (windows, width, heads · coefficients), and the values,
(windows, heads, coefficients, width / heads)."""


@dataclass(frozen=True)
class PreparedCondition:
    """All that a pass takes from the condition: computed once a window, used in every step and for every sample."""

    vector: Float[Tensor, "windows #samples width"]
    """Is added to the embedding of the step; one for all samples, or one for each."""
    memories: tuple[_Memory | None, ...]
    """What each block's cross-attention makes of the condition."""


class CoefficientDenoiser(nn.Module):
    """Predicts the noise in noisy DCT coefficients from the step and a condition of as many coefficients.

    Args:
        configuration: Sizes, and whether there is cross-attention.
    """

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width, values, rows = configuration.width, configuration.values, configuration.coefficients
        self.places = nn.Parameter(torch.randn(rows, width))
        self.input = nn.Linear(values, width)
        self.condition = nn.Linear(rows * values, width)
        self.time = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.blocks = nn.ModuleList(_Block(configuration) for _ in range(configuration.layers))
        self.output = _from_zero(nn.Linear(width, values))
        table = sinusoid_table(configuration.diffusion_steps, width)
        # The published programs have all cosines in front of all sines.
        self.register_buffer("sinusoid", torch.cat([table[:, 1::2], table[:, ::2]], dim=1), persistent=False)
        self.sinusoid: Tensor

    def forward(
        self,
        noisy: Float[Tensor, "windows samples coefficients values"],
        step: Int[Tensor, " steps"],
        prepared: PreparedCondition,
    ) -> Float[Tensor, "windows samples coefficients values"]:
        """Predict the noise.

        Args:
            noisy: Noisy coefficients of each sample.
            step: Index in the training schedule: one for all windows, or one for each.
            prepared: What :meth:`prepare` has made of the condition.
        """
        time = nn.functional.silu(self.time(self.sinusoid[step])[:, None] + prepared.vector)
        stream = self.input(noisy) + self.places
        half = len(self.blocks) // 2
        skips = []
        for place, (block, memory) in enumerate(zip(self.blocks, prepared.memories, strict=True)):
            if place < half:
                skips.append(stream)
            stream = block(stream, time, memory)
            if place >= half:
                stream = stream + skips.pop()
        return self.output(stream)

    def prepare(
        self,
        condition: Float[Tensor, "windows coefficients values"],
        kept: Bool[Tensor, "windows samples"] | None = None,
    ) -> PreparedCondition:
        """Compute what the condition contributes to every pass.

        Args:
            condition: Fused features, or the coefficients of the padded observation.
            kept: Which samples keep the condition vector; None if all do. Cross-attention sees the condition of
                all of them: it has no samples of its own.
        """
        vector = self.condition(condition.flatten(1))[:, None]
        if kept is not None:
            vector = vector * kept[..., None]
        return PreparedCondition(vector, tuple(cast(_Block, block).memory(condition) for block in self.blocks))


class _Block(nn.Module):
    """Self-attention, cross-attention if there is any, feed-forward; each stylised and residual."""

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        width, dropout, self.heads = configuration.width, configuration.dropout, configuration.heads
        self.dropout = dropout
        self.norm = nn.LayerNorm(width)
        self.query_key_value = nn.Linear(width, 3 * width, bias=False)
        self.attention_style = _Stylisation(width, dropout)
        self.cross = _CrossAttention(configuration) if configuration.cross_attention else None
        self.expand = nn.Linear(width, configuration.feed_forward)
        self.contract = _from_zero(nn.Linear(configuration.feed_forward, width))
        self.feed_forward_dropout = nn.Dropout(dropout)
        self.feed_forward_style = _Stylisation(width, dropout)

    def forward(
        self,
        stream: Float[Tensor, "windows samples coefficients width"],
        time: Float[Tensor, "rows samples_or_1 width"],
        memory: _Memory | None,
    ) -> Float[Tensor, "windows samples coefficients width"]:
        """Apply to every sample by itself; ``time`` is SiLU(step + condition)."""
        parts = self.query_key_value(self.norm(stream)).unflatten(-1, (3, self.heads, -1)).movedim(-3, 0)
        query, key, value = parts.transpose(-3, -2).flatten(1, 2)
        attended = functional.scaled_dot_product_attention(query, key, value, dropout_p=self._dropping)
        attended = attended.transpose(1, 2).flatten(2).view_as(stream)
        stream = stream + self.attention_style(attended, time)
        if self.cross is not None and memory is not None:
            stream = stream + self.cross(stream, time, memory)
        hidden = self.feed_forward_dropout(functional.gelu(self.expand(stream)))
        return stream + self.feed_forward_style(self.contract(hidden), time)

    def memory(self, condition: Float[Tensor, "windows coefficients values"]) -> _Memory | None:
        """Compute keys and values of the condition; None without cross-attention."""
        return None if self.cross is None else self.cross.memory(condition)

    @property
    def _dropping(self) -> float:
        return self.dropout if self.training else 0.0


class _CrossAttention(nn.Module):
    """Queries from the motion; keys and values from the condition, a token each coefficient."""

    def __init__(self, configuration: DiffusionConfiguration) -> None:
        super().__init__()
        width, values, self.heads = configuration.width, configuration.values, configuration.heads
        self.dropout = configuration.dropout
        self.norm = nn.LayerNorm(width)
        self.condition_norm = nn.LayerNorm(values)
        self.query = nn.Linear(width, width, bias=False)
        self.key_value = nn.Linear(values, 2 * width, bias=False)
        self.style = _Stylisation(width, configuration.dropout)

    def forward(
        self,
        stream: Float[Tensor, "windows samples coefficients width"],
        time: Float[Tensor, "rows samples_or_1 width"],
        memory: _Memory,
    ) -> Float[Tensor, "windows samples coefficients width"]:
        """Look at the coefficients of the condition, from each coefficient of each sample.

        Args:
            stream: Of the samples.
            time: Embedding of the diffusion step, a row for each sample or one for all.
            memory: See :meth:`memory`.
        """
        scored, values = memory
        scores = (self.norm(stream).flatten(1, 2) @ scored).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        shares = functional.dropout(scores.softmax(dim=-1), self.dropout, self.training)
        return self.style((shares @ values).transpose(1, 2).flatten(2).view_as(stream), time)

    def memory(self, condition: Float[Tensor, "windows coefficients values"]) -> _Memory:
        both = self.key_value(self.condition_norm(condition)).unflatten(-1, (2, self.heads, -1))
        key, value = both.movedim(-3, 0).transpose(-3, -2)
        # A score is (W h) · k = h · (Wᵀ k): queries, which every sample and step would need, are never made.
        query = self.query.weight.unflatten(0, (self.heads, -1)) / math.sqrt(key.shape[-1])
        scored = torch.einsum("hdc,whld->wchl", query, key)
        return scored.flatten(2), value


class _Stylisation(nn.Module):
    """Linear(Dropout(SiLU(norm(h) · (1 + s) + b))) with s and b from step and condition; the linear starts at zero."""

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.scale_shift = nn.Linear(width, 2 * width)
        self.norm = nn.LayerNorm(width)
        self.dropout = nn.Dropout(dropout)
        self.output = _from_zero(nn.Linear(width, width))

    def forward(
        self,
        stream: Float[Tensor, "windows samples coefficients width"],
        time: Float[Tensor, "rows samples_or_1 width"],
    ) -> Float[Tensor, "windows samples coefficients width"]:
        scale, shift = self.scale_shift(time)[:, :, None].chunk(2, dim=-1)
        return self.output(self.dropout(functional.silu(torch.addcmul(shift, self.norm(stream), 1 + scale))))


def _from_zero(layer: nn.Linear) -> nn.Linear:
    nn.init.zeros_(layer.weight)
    nn.init.zeros_(layer.bias)
    return layer
