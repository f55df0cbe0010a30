"""The transformer layer of all denoisers: self-attention, cross-attention if asked for, feed-forward; post-norm.

Everything is batch first. Masks are ``visible`` masks: True where a key may be looked at, None if all may.
"""

from __future__ import annotations

import math

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn import functional

KeysValues = tuple[Tensor, Tensor]
"""Keys and values of one layer's cross-attention, each (batch, heads, tokens, width / heads)."""


class _SelfAttention(nn.Module):
    """Multi-head attention of a stream to itself."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.query_key_value = nn.Linear(width, 3 * width)
        self.output = nn.Linear(width, width)
        _reset(self.query_key_value, self.output)

    def forward(
        self, stream: Float[Tensor, "batch length width"], visible: Bool[Tensor, "batch 1 1 length"] | None
    ) -> Float[Tensor, "batch length width"]:
        """Attend; ``visible`` says which positions of the stream are keys."""
        query, key, value = _split_heads(self.query_key_value(stream), 3, self.heads)
        return self.output(_attend(query, key, value, visible, self.dropout if self.training else 0.0))


class CrossAttention(nn.Module):
    """Multi-head attention of a stream to memory tokens, whose keys and values can be computed ahead."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.output = nn.Linear(width, width)
        _reset(self.query, self.key_value, self.output)

    def keys_values(self, memory: Float[Tensor, "batch tokens width"]) -> KeysValues:
        """Compute the contribution of the memory tokens, whatever the stream."""
        key, value = _split_heads(self.key_value(memory), 2, self.heads)
        return key, value

    def of_one_token(self, memory: Float[Tensor, "batch 1 width"]) -> Float[Tensor, "batch 1 width"]:
        """The result for a memory of one token, equal for every query: softmax over one key is 1."""
        width = memory.shape[-1]
        # The second half of the joint projection makes the values.
        value = functional.linear(memory, self.key_value.weight[width:], self.key_value.bias[width:])
        return self.output(value)

    def forward(
        self,
        stream: Float[Tensor, "batch length width"],
        keys_values: KeysValues,
        visible: Bool[Tensor, "batch 1 1 tokens"] | None,
    ) -> Float[Tensor, "batch length width"]:
        """Attend to what :meth:`keys_values` has made of the memory."""
        (query,) = _split_heads(self.query(stream), 1, self.heads)
        return self.output(_attend(query, *keys_values, visible, self.dropout if self.training else 0.0))


class _FeedForward(nn.Module):
    """Two linear layers with an exact GELU between them."""

    def __init__(self, width: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.expand = nn.Linear(width, hidden)
        self.contract = nn.Linear(hidden, width)
        self.dropout = nn.Dropout(dropout)

    def forward(self, stream: Float[Tensor, "batch length width"]) -> Float[Tensor, "batch length width"]:
        """Apply to every position by itself."""
        return self.contract(self.dropout(functional.gelu(self.expand(stream))))


class TransformerLayer(nn.Module):
    """Self-attention, cross-attention (in a decoder only) and feed-forward, each residual and normalised afterwards."""

    def __init__(self, width: int, heads: int, feed_forward: int, dropout: float, *, cross_attention: bool) -> None:
        super().__init__()
        self.self_attention = _SelfAttention(width, heads, dropout)
        self.self_attention_norm = nn.LayerNorm(width, eps=1e-5)
        if cross_attention:
            self.cross_attention = CrossAttention(width, heads, dropout)
            self.cross_attention_norm = nn.LayerNorm(width, eps=1e-5)
        self.feed_forward = _FeedForward(width, feed_forward, dropout)
        self.feed_forward_norm = nn.LayerNorm(width, eps=1e-5)
        self.dropout = nn.Dropout(dropout)

    def forward(
        self,
        stream: Float[Tensor, "batch length width"],
        visible: Bool[Tensor, "batch 1 1 length"] | None,
        memory: KeysValues | Tensor | None,
        memory_visible: Bool[Tensor, "batch 1 1 tokens"] | None,
    ) -> Float[Tensor, "batch length width"]:
        """One layer.

        Args:
            stream: Frame tokens, those put in front included.
            visible: Which of them may be attended to.
            memory: Keys and values of the memory tokens; the finished (batch, 1, width) result of
                :meth:`CrossAttention.of_one_token`; None in an encoder.
            memory_visible: Which memory tokens may be attended to.
        """
        attended = self.self_attention(stream, visible)
        stream = self.self_attention_norm(stream + self.dropout(attended))
        if memory is not None:
            constant = isinstance(memory, Tensor)
            injected = memory if constant else self.cross_attention(stream, memory, memory_visible)
            stream = self.cross_attention_norm(stream + self.dropout(injected))
        return self.feed_forward_norm(stream + self.dropout(self.feed_forward(stream)))


def sinusoid_table(rows: int, width: int) -> Float[Tensor, "rows width"]:
    """Row p: sin(p·10000^(-2i/width)) at 2i and the cosine of the same at 2i + 1; float32 of float64 angles."""
    frequency = torch.exp(torch.arange(0, width, 2, dtype=torch.float64) * (-math.log(10000.0) / width))
    angle = torch.arange(rows, dtype=torch.float64)[:, None] * frequency
    return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1).float()


def _split_heads(projected: Tensor, parts: int, heads: int) -> tuple[Tensor, ...]:
    """(batch, length, parts · width) as ``parts`` views of shape (batch, heads, length, width / heads).

    Cut before it is reshaped: the gradients are then joined along the last axis, without a further copy.
    """
    batch, length, _ = projected.shape
    return tuple(part.view(batch, length, heads, -1).transpose(1, 2) for part in projected.chunk(parts, dim=-1))


def _attend(query: Tensor, key: Tensor, value: Tensor, visible: Tensor | None, dropout: float) -> Tensor:
    if query.device.type == "cpu" and query.dtype == torch.bfloat16:
        attended = _attend_written_out(query, key, value, visible, dropout)
    else:
        attended = functional.scaled_dot_product_attention(query, key, value, attn_mask=visible, dropout_p=dropout)
    return attended.transpose(1, 2).flatten(2)


def _attend_written_out(query: Tensor, key: Tensor, value: Tensor, visible: Tensor | None, dropout: float) -> Tensor:
    """Attend step by step: on CPUs the gradient of the fused bfloat16 kernel takes four times as long."""
    scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
    if visible is not None:
        scores = scores.masked_fill(~visible, -math.inf)
    weights = functional.dropout(scores.softmax(dim=-1), dropout)
    return weights.to(value.dtype) @ value


def _reset(*layers: nn.Linear) -> None:
    """Start projections of attention as is usual for transformers: Glorot's uniform weights, no bias."""
    for layer in layers:
        nn.init.xavier_uniform_(layer.weight)
        nn.init.zeros_(layer.bias)
