"""The x0-predicting transformers shared by MDM, DNO and P&R, and the ways in which conditions enter them.

Sources: docs/specification/mdm.md#network, docs/specification/pr-model.md#network; *Prime and Reach*, sections 4.1
and D.3, equation 8. Both ways start at zero, so that fine-tuning starts at the output of the pre-trained model.

:class:`FrameDenoiser` is ours, for small models (``architecture = "frames"``; docs/methods/pr.md), with two changes to
the study's decoder. Condition, text and diffusion step are added to every frame token in every layer, where the decoder
reaches them through attention; and a token knows its time before the end as well as its time since the start.

Everything is batch first. Masks are ``visible`` masks: True where a key may be looked at, None if all may.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar, cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn, softmax, stack
from torch.nn import functional

from prbench.representation.features import N_FEATURES
from prbench_adapters.diffusion.configuration import DenoiserConfiguration, EncodedCondition

Frames = Float[Tensor, "batch length width"]  # embedded frames
Tokens = Float[Tensor, "batch tokens width"]  # embedded conditions
Features = Float[Tensor, "batch frames 263"]
Counts = Int[Tensor, " batch"]  # one whole number a motion
Valid = Bool[Tensor, "batch frames"]  # frames that are no padding
Inputs = Float[Tensor, "batch frames features"]
Attended = Bool[Tensor, "batch 1 1 tokens"]
Given = Bool[Tensor, "batch tokens"]
Layer = TypeVar("Layer", bound=nn.Module)

# Keys and values of one layer's cross-attention, each (batch, heads, tokens, width / heads).
KeysValues = tuple[Tensor, Tensor]


class SelfAttention(nn.Module):
    """Multi-head attention of a stream to itself."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.query_key_value = nn.Linear(width, 3 * width)
        self.output = nn.Linear(width, width)
        _reset(self.query_key_value, self.output)

    def forward(self, stream: Frames, visible: Bool[Tensor, "batch 1 1 length"] | None) -> Frames:
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

    def keys_values(self, memory: Tokens) -> KeysValues:
        """Compute the contribution of the memory tokens, whatever the stream."""
        key, value = _split_heads(self.key_value(memory), 2, self.heads)
        return key, value

    def of_one_token(self, memory: Float[Tensor, "batch 1 width"]) -> Float[Tensor, "batch 1 width"]:
        """Return the result for a memory of one token, equal for every query: softmax over one key is 1."""
        width = memory.shape[-1]
        # The second half of the joint projection makes the values.
        return self.output(functional.linear(memory, self.key_value.weight[width:], self.key_value.bias[width:]))

    def forward(self, stream: Frames, keys_values: KeysValues, visible: Attended | None) -> Frames:
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

    def forward(self, stream: Frames) -> Frames:
        """Apply to every position by itself."""
        return self.contract(self.dropout(functional.gelu(self.expand(stream))))


class TransformerLayer(nn.Module):
    """Self-attention, cross-attention (in a decoder only) and feed-forward, each residual and normalised afterwards."""

    def __init__(self, width: int, heads: int, feed_forward: int, dropout: float, *, cross_attention: bool) -> None:
        super().__init__()
        self.self_attention = SelfAttention(width, heads, dropout)
        self.self_attention_norm = nn.LayerNorm(width, eps=1e-5)
        if cross_attention:
            self.cross_attention = CrossAttention(width, heads, dropout)
            self.cross_attention_norm = nn.LayerNorm(width, eps=1e-5)
        self.feed_forward = _FeedForward(width, feed_forward, dropout)
        self.feed_forward_norm = nn.LayerNorm(width, eps=1e-5)
        self.dropout = nn.Dropout(dropout)

    def forward(
        self,
        stream: Frames,
        visible: Bool[Tensor, "batch 1 1 length"] | None,
        memory: KeysValues | Tensor | None,
        memory_visible: Attended | None,
    ) -> Frames:
        """One layer.

        Args:
            stream: Frame tokens, those put in front included.
            visible: Which of them may be attended to.
            memory: Keys and values of the memory tokens; the finished (batch, 1, width) result of
                :meth:`CrossAttention.of_one_token`; None in an encoder.
            memory_visible: Which memory tokens may be attended to.
        """
        stream = self.self_attention_norm(stream + self.dropout(self.self_attention(stream, visible)))
        if memory is not None:
            injected = memory if isinstance(memory, Tensor) else self.cross_attention(stream, memory, memory_visible)
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
        # Attend step by step: on CPUs the gradient of the fused bfloat16 kernel takes four times as long.
        scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
        if visible is not None:
            scores = scores.masked_fill(~visible, -math.inf)
        attended = functional.dropout(scores.softmax(dim=-1), dropout).to(value.dtype) @ value
    else:
        attended = functional.scaled_dot_product_attention(query, key, value, attn_mask=visible, dropout_p=dropout)
    return attended.transpose(1, 2).flatten(2)


def _reset(*layers: nn.Linear) -> None:
    """Start projections of attention as is usual for transformers: Glorot's uniform weights, no bias."""
    for layer in layers:
        nn.init.xavier_uniform_(layer.weight)
        nn.init.zeros_(layer.bias)


def from_zero(layer: Layer) -> Layer:
    """Return the layer with all of its parameters set to zero."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer


class _Addition(nn.Module):
    """z̃ = z + Linear(p), the same for every memory token."""

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        # Zero at the start: before the first step of fine-tuning the output is that of the pre-trained model.
        self.projection = from_zero(nn.Linear(configuration.condition_size, configuration.width))

    def forward(self, tokens: Tokens, vector: Float[Tensor, "batch size"]) -> Tokens:
        """Add the projected vector to every token."""
        return tokens + self.projection(vector)[:, None]


class _CrossAttentionInjection(nn.Module):
    """z̃ = z + softmax(z W_Q (P W_K)ᵀ / √d) P W_V with three condition tokens P: pose, velocity and goal.

    With one token the softmax would be over one element and this would be an addition
    (docs/specification/pr-model.md#network); so each part of the vector has a linear layer of its own.
    """

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        width = configuration.width
        self.parts = tuple(configuration.condition_parts.values())
        self.embeddings = nn.ModuleDict(
            {name: nn.Linear(part.stop - part.start, width) for name, part in configuration.condition_parts.items()}
        )
        self.query = nn.Linear(width, width, bias=False)
        self.key = nn.Linear(width, width, bias=False)
        self.value = from_zero(nn.Linear(width, width, bias=False))

    def forward(self, tokens: Tokens, vector: Float[Tensor, "batch size"]) -> Tokens:
        """Let every token look at the three parts of the vector."""
        embeddings = zip(self.embeddings.values(), self.parts, strict=True)
        parts = stack([layer(vector[:, part]) for layer, part in embeddings], dim=1)
        scores = self.query(tokens) @ self.key(parts).transpose(1, 2) / math.sqrt(tokens.shape[-1])
        return tokens + softmax(scores, dim=-1) @ self.value(parts)


@dataclass(frozen=True)
class PreparedCondition:
    """Everything that a pass takes from condition and step: computed once, used for as many passes as wanted.

    Attributes:
        front: The token put in front of the frames, if there is one.
        layers: One entry a layer: keys and values of the memory; the constant of a single memory token; None in an
            encoder.
        visible: True for memory tokens that may be attended to; None for all of them.
    """

    front: Float[Tensor, "batch 1 width"] | None
    layers: tuple[KeysValues | Tensor | None, ...]
    visible: Attended | None


class Denoiser(nn.Module):
    """Estimates the clean motion features from noisy ones, the step, and the condition.

    ``encoder``: one token (text + time + condition) in front of the frames. ``decoder``: the frames attend to memory
    tokens, each Linear(text token) + time + condition.
    """

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.width
        self.frame_embedding = nn.Linear(N_FEATURES * configuration.frames_per_token, width)
        self.time_embedding = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.text_embedding = nn.Linear(configuration.text_dimension, width)
        injections = {"addition": _Addition, "cross-attention": _CrossAttentionInjection}
        self.condition = injections[configuration.injection](configuration) if configuration.condition_size else None
        self.dropout = nn.Dropout(configuration.dropout)
        sizes = (width, configuration.heads, configuration.feed_forward, configuration.dropout)
        crosses = configuration.architecture == "decoder"
        layers = range(configuration.layers)
        self.layers = nn.ModuleList(TransformerLayer(*sizes, cross_attention=crosses) for _ in layers)
        self.head = nn.Linear(width, N_FEATURES * configuration.frames_per_token)
        # One table for both: frames count their places in it, with the token in front, and diffusion steps theirs.
        rows = max(configuration.max_frames + 1, configuration.diffusion_steps)
        self.register_buffer("sinusoid", sinusoid_table(rows, width), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Features, step: Counts, condition: EncodedCondition, n_frames: Counts) -> Features:
        """Estimate the clean features.

        Args:
            noisy: Noisy normalised features x_t; what stands behind ``n_frames`` leaves no trace in what stands before.
            step: Index t in the training schedule, 0 … T - 1.
            condition: Text and condition vector.
            n_frames: Valid frames of each row. If it lies on the CPU and all rows are full, no mask is applied.
        """
        return self.denoise(noisy, self.prepare(condition, step), frame_mask(n_frames, noisy.shape[1], noisy.device))

    def denoise(self, noisy: Features, prepared: PreparedCondition, visible: Valid | None) -> Features:
        """Return part of :meth:`forward` that depends on the noisy features; ``visible`` is :func:`frame_mask`'s."""
        frames = noisy.shape[1]
        noisy, visible = self._tokens(noisy, visible)
        stream = self.frame_embedding(noisy)
        in_front = 0 if prepared.front is None else 1
        if prepared.front is not None:
            stream = torch.cat([prepared.front.to(stream.dtype), stream], dim=1)
        if visible is not None:
            # The token in front belongs to every row and is never padding.
            visible = nn.functional.pad(visible, (in_front, 0), value=True)[:, None, None]
        stream = self.dropout(stream + self.sinusoid[: stream.shape[1]])
        for layer, memory in zip(self.layers, prepared.layers, strict=True):
            stream = layer(stream, visible, memory, prepared.visible)
        return self.head(stream[:, in_front:]).unflatten(-1, (-1, N_FEATURES)).flatten(1, 2)[:, :frames]

    def _tokens(
        self, noisy: Features, visible: Valid | None
    ) -> tuple[Float[Tensor, "batch tokens size"], Given | None]:
        """Join the frames of each token; a token with a valid frame is visible, and its padded frames are zeros."""
        together = self.configuration.frames_per_token
        if together == 1:
            return noisy, visible
        missing = -noisy.shape[1] % together
        if visible is not None:
            noisy = noisy.masked_fill(~visible[..., None], 0.0)
            visible = nn.functional.pad(visible, (0, missing)).unflatten(1, (-1, together)).any(dim=2)
        return nn.functional.pad(noisy, (0, 0, 0, missing)).unflatten(1, (-1, together)).flatten(2), visible

    def prepare(self, condition: EncodedCondition, step: Int[Tensor, " rows"]) -> PreparedCondition:
        """Return the part of :meth:`forward` that depends on condition and step; ``step`` has one entry, or one a row.

        A memory of one token becomes a constant per layer, except in training, where its queries and keys take part.
        """
        memory = self.memory(condition, step)
        if self.configuration.architecture == "encoder":
            return PreparedCondition(memory, (None,) * len(self.layers), None)
        front = self._time(step).expand(len(condition), -1, -1) if self.configuration.time_in_frames else None
        attentions = [cast(CrossAttention, layer.cross_attention) for layer in self.layers]
        if memory.shape[1] == 1 and not self.training:
            return PreparedCondition(front, tuple(attention.of_one_token(memory) for attention in attentions), None)
        visible = None
        padding = condition.padding
        # As for frames, only a host tensor is looked at: elsewhere the host would have to wait for the device.
        if memory.shape[1] > 1 and (padding.device.type != "cpu" or bool(padding[:, 1:].any())):
            visible = ~padding
            visible[:, 0] = True  # a row without any word still has its first token
            visible = visible[:, None, None]
        return PreparedCondition(front, tuple(attention.keys_values(memory) for attention in attentions), visible)

    def memory(self, condition: EncodedCondition, step: Int[Tensor, " rows"]) -> Tokens:
        """Condition tokens: Linear(text) + time + the injected condition vector.

        Raises:
            ValueError: if the condition vector is missing, or given to a model that takes none.
        """
        if (condition.vector is None) is not (self.condition is None):
            verb = "needs a condition vector" if self.condition is not None else "takes no condition vector"
            raise ValueError(f"a denoiser with goal '{self.configuration.goal}' {verb}")
        text = torch.zeros_like(condition.text) if "text" in self.configuration.dropped else condition.text
        if self.configuration.architecture == "encoder" or self.configuration.text_tokens == "pooled":
            text = pooled(text, condition.padding)
        tokens = self.text_embedding(text) + self._time(step)
        return tokens if self.condition is None else self.condition(tokens, condition.vector)

    def _time(self, step: Int[Tensor, " rows"]) -> Float[Tensor, "rows 1 width"]:
        return self.time_embedding(self.sinusoid[step])[:, None]


def frame_mask(n_frames: Counts, frames: int, device: torch.device) -> Valid | None:
    """Return True for valid frames; None if all are.

    That is looked at only if ``n_frames`` lies on the CPU: elsewhere the host would have to wait for the device.
    """
    if n_frames.device.type == "cpu" and bool((n_frames >= frames).all()):
        return None
    return torch.arange(frames, device=device) < n_frames.to(device, non_blocking=True)[:, None]


def pooled(text: Float[Tensor, "batch tokens dimension"], padding: Given) -> Float[Tensor, "batch 1 dimension"]:
    """Mean over the word pieces of each row."""
    # At least 1 below, so that a text without word pieces gives zeros and no NaN.
    weight = (~padding).to(text.dtype)[..., None]
    return (text * weight).sum(dim=1, keepdim=True) / weight.sum(dim=1, keepdim=True).clamp_min(1.0)


_NEIGHBOURS = 2  # tokens before and after


class FrameLayer(nn.Module):
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

    def forward(self, stream: Tokens, condition: Float[Tensor, "batch width"], visible: Given) -> Tokens:
        """One layer; ``visible`` is True for tokens that are no padding."""
        stream = stream + self.condition(condition)[:, None]
        parts = self.query_key_value(self.attention_norm(stream)).chunk(3, dim=-1)
        query, key, value = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts)
        # Written out: for so few tokens it takes a third of the time of the fused kernels of processors.
        scores = (query * query.shape[-1] ** -0.5) @ key.transpose(-1, -2)
        scores = scores.masked_fill(~visible[:, None, None], -math.inf)
        stream = stream + self.dropout(self.output((scores.softmax(dim=-1) @ value).transpose(1, 2).flatten(2)))
        # Each token beside its neighbours.
        around = self.feed_forward_norm(stream) * visible[..., None]
        padded = functional.pad(around, (0, 0, _NEIGHBOURS, _NEIGHBOURS))
        for place, weight in enumerate(self.neighbours):
            around = around + weight * padded[:, place : place + around.shape[1]]
        return stream + self.dropout(self.contract(functional.gelu(self.expand(around), approximate="tanh")))


class FrameDenoiser(nn.Module):
    """Estimates the clean goal-frame features from noisy ones, the step, and the condition.

    Args:
        configuration: A configuration with ``features = "goal-frame"``.
    """

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.width
        numbers = configuration.n_features * configuration.frames_per_token
        self.frame_embedding = nn.Linear(numbers, width)
        told = configuration.condition_size + configuration.text_dimension
        self.condition_embedding = nn.Sequential(nn.Linear(told, 2 * width), nn.SiLU(), nn.Linear(2 * width, width))
        self.step_embedding = nn.Embedding(configuration.diffusion_steps, width)
        self.time_to_end = nn.Linear(width, width)
        sizes = (width, configuration.heads, configuration.feed_forward, configuration.dropout)
        self.layers = nn.ModuleList(FrameLayer(*sizes) for _ in range(configuration.layers))
        self.head_norm = nn.LayerNorm(width)
        self.head = from_zero(nn.Linear(width, numbers))  # the first estimate is the mean motion
        self.register_buffer("sinusoid", sinusoid_table(configuration.max_frames + 1, width), persistent=False)
        self.sinusoid: Tensor

    def forward(self, noisy: Inputs, step: Counts, condition: EncodedCondition, n_frames: Counts) -> Inputs:
        """Estimate the clean features; the arguments are those of :class:`~.denoiser.Denoiser`."""
        return self.denoise(noisy, self.prepare(condition, step), frame_mask(n_frames, noisy.shape[1], noisy.device))

    def prepare(self, condition: EncodedCondition, step: Int[Tensor, " rows"]) -> Float[Tensor, "batch width"]:
        """Return the part of :meth:`forward` that depends on condition and step; ``step`` has one entry, or one a row.

        Raises:
            ValueError: if the condition has no vector.
        """
        if condition.vector is None:
            raise ValueError(f"a denoiser with goal '{self.configuration.goal}' needs a condition vector")
        text = pooled(condition.text, condition.padding)[:, 0]
        told = self.condition_embedding(torch.cat((condition.vector, text), dim=1))
        return functional.silu(told + self.step_embedding(step))

    def denoise(self, noisy: Inputs, prepared: Float[Tensor, "batch width"], visible: Valid | None) -> Inputs:
        """Return part of :meth:`forward` that depends on the noisy features; ``visible`` is :func:`frame_mask`'s."""
        frames = noisy.shape[1]
        if visible is None:
            visible = torch.ones(noisy.shape[:2], dtype=torch.bool, device=noisy.device)
        # Each token's time since the start and before the end.
        begun = torch.arange(0, frames, self.configuration.frames_per_token, device=visible.device)
        left = (visible.sum(dim=1)[:, None] - 1 - begun).clamp_min(0)
        times = self.sinusoid[begun] + self.time_to_end(self.sinusoid[left])
        stream = self.frame_embedding(self._tokens(noisy, visible)) + times
        shown = self._tokens(visible[..., None], visible).any(dim=2)
        for layer in self.layers:
            stream = layer(stream, prepared, shown)
        clean = self.head(self.head_norm(stream))
        return clean.unflatten(-1, (self.configuration.frames_per_token, -1)).flatten(1, 2)[:, :frames]

    def _tokens(self, values: Tensor, visible: Valid) -> Tensor:
        """Join the frames of each token; padded frames are zeros."""
        together = self.configuration.frames_per_token
        values = values.masked_fill(~visible[..., None], 0)
        return functional.pad(values, (0, 0, 0, -values.shape[1] % together)).unflatten(1, (-1, together)).flatten(2)


Network = Denoiser | FrameDenoiser
