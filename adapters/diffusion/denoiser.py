"""The x0-predicting transformer shared by MDM, DNO and P&R, and the two ways in which conditions enter it.

Sources: docs/specification/mdm.md#network, docs/specification/pr-model.md#network; *Prime and Reach*, sections 4.1
and D.3, equation 8. Both ways start at zero, so that fine-tuning starts at the output of the pre-trained model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn, softmax, stack

from prbench.representation.features import N_FEATURES
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.configuration import DenoiserConfiguration
from prbench_adapters.diffusion.layers import CrossAttention, KeysValues, TransformerLayer, sinusoid_table


class _Addition(nn.Module):
    """z̃ = z + Linear(p), the same for every memory token."""

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        self.projection = nn.Linear(configuration.condition_size, configuration.width)
        # Zero at the start: before the first step of fine-tuning the output is that of the pre-trained model.
        nn.init.zeros_(self.projection.weight)
        nn.init.zeros_(self.projection.bias)

    def forward(
        self, tokens: Float[Tensor, "batch tokens width"], vector: Float[Tensor, "batch size"]
    ) -> Float[Tensor, "batch tokens width"]:
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
        self.value = nn.Linear(width, width, bias=False)
        nn.init.zeros_(self.value.weight)

    def forward(
        self, tokens: Float[Tensor, "batch tokens width"], vector: Float[Tensor, "batch size"]
    ) -> Float[Tensor, "batch tokens width"]:
        """Let every token look at the three parts of the vector."""
        parts = stack(
            [layer(vector[:, part]) for layer, part in zip(self.embeddings.values(), self.parts, strict=True)], dim=1
        )
        scores = self.query(tokens) @ self.key(parts).transpose(1, 2) / math.sqrt(tokens.shape[-1])
        return tokens + softmax(scores, dim=-1) @ self.value(parts)


@dataclass(frozen=True)
class PreparedCondition:
    """Everything that a pass takes from condition and step: computed once, used for as many passes as wanted."""

    front: Float[Tensor, "batch 1 width"] | None
    """The token put in front of the frames, if there is one."""
    layers: tuple[KeysValues | Tensor | None, ...]
    """Per layer: keys and values of the memory; the constant of a single memory token; None in an encoder."""
    visible: Bool[Tensor, "batch 1 1 tokens"] | None
    """True for memory tokens that may be attended to; None for all of them."""


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
        self.layers = nn.ModuleList(
            TransformerLayer(
                width,
                configuration.heads,
                configuration.feed_forward,
                configuration.dropout,
                cross_attention=configuration.architecture == "decoder",
            )
            for _ in range(configuration.layers)
        )
        self.head = nn.Linear(width, N_FEATURES * configuration.frames_per_token)
        # One table for both: frames count their places in it, with the token in front, and diffusion steps theirs.
        rows = max(configuration.max_frames + 1, configuration.diffusion_steps)
        self.register_buffer("sinusoid", sinusoid_table(rows, width), persistent=False)
        self.sinusoid: Tensor

    def forward(
        self,
        noisy: Float[Tensor, "batch frames 263"],
        step: Int[Tensor, " batch"],
        condition: EncodedCondition,
        n_frames: Int[Tensor, " batch"],
    ) -> Float[Tensor, "batch frames 263"]:
        """Estimate the clean features.

        Args:
            noisy: Noisy normalised features x_t; what stands behind ``n_frames`` leaves no trace in what stands before.
            step: Index t in the training schedule, 0 … T - 1.
            condition: Text and condition vector.
            n_frames: Valid frames of each row. If it lies on the CPU and all rows are full, no mask is applied.
        """
        return self.denoise(noisy, self.prepare(condition, step), frame_mask(n_frames, noisy.shape[1], noisy.device))

    def denoise(
        self,
        noisy: Float[Tensor, "batch frames 263"],
        prepared: PreparedCondition,
        visible: Bool[Tensor, "batch frames"] | None,
    ) -> Float[Tensor, "batch frames 263"]:
        """The part of :meth:`forward` that depends on the noisy features; ``visible`` is :func:`frame_mask`'s."""
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
        self, noisy: Float[Tensor, "batch frames 263"], visible: Bool[Tensor, "batch frames"] | None
    ) -> tuple[Float[Tensor, "batch tokens size"], Bool[Tensor, "batch tokens"] | None]:
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
        """The part of :meth:`forward` that depends on condition and step; ``step`` has one entry a row, or one for all.

        A memory of one token becomes a constant per layer, except in training, where its queries and keys take part.
        """
        memory = self.memory(condition, step)
        if self.configuration.architecture == "encoder":
            return PreparedCondition(memory, (None,) * len(self.layers), None)
        front = self._time(step).expand(len(condition), -1, -1) if self.configuration.time_in_frames else None
        attentions = [cast(CrossAttention, layer.cross_attention) for layer in self.layers]
        if memory.shape[1] == 1 and not self.training:
            return PreparedCondition(front, tuple(attention.of_one_token(memory) for attention in attentions), None)
        visible = None if memory.shape[1] == 1 else _token_mask(condition.padding)
        return PreparedCondition(front, tuple(attention.keys_values(memory) for attention in attentions), visible)

    def memory(self, condition: EncodedCondition, step: Int[Tensor, " rows"]) -> Float[Tensor, "batch tokens width"]:
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

    @torch.no_grad()
    def take_steps(self, other: Denoiser, steps: Int[Tensor, " kept"]) -> None:
        """Take over the weights of another denoiser, whose steps ``steps`` become the steps 0, 1, … here.

        The first layer of the time embedding changes by the smallest matrix that maps the sinusoids of the new numbers
        to what it has made of those of the old ones, so that both networks compute the same.
        """
        self.load_state_dict(other.state_dict())
        first = cast(nn.Linear, self.time_embedding[0])
        old = other.sinusoid[steps].double()
        new = self.sinusoid[: len(steps)].double()
        change = first.weight.double() @ (old - new).T @ torch.linalg.pinv(new.T)
        first.weight += change.to(first.weight.dtype)


def frame_mask(
    n_frames: Int[Tensor, " batch"], frames: int, device: torch.device
) -> Bool[Tensor, "batch frames"] | None:
    """True for valid frames; None if all are.

    That is looked at only if ``n_frames`` lies on the CPU: elsewhere the host would have to wait for the device.
    """
    if n_frames.device.type == "cpu" and bool((n_frames >= frames).all()):
        return None
    return torch.arange(frames, device=device) < n_frames.to(device, non_blocking=True)[:, None]


def _token_mask(padding: Bool[Tensor, "batch tokens"]) -> Bool[Tensor, "batch 1 1 tokens"] | None:
    """True for word pieces that may be attended to, among them the first of each row; None as in :func:`frame_mask`."""
    if padding.device.type == "cpu" and not bool(padding[:, 1:].any()):
        return None
    visible = ~padding
    visible[:, 0] = True
    return visible[:, None, None]


def pooled(
    text: Float[Tensor, "batch tokens dimension"], padding: Bool[Tensor, "batch tokens"]
) -> Float[Tensor, "batch 1 dimension"]:
    """Mean over the word pieces of each row."""
    # At least 1 below, so that a text without word pieces gives zeros and no NaN.
    weight = (~padding).to(text.dtype)[..., None]
    return (text * weight).sum(dim=1, keepdim=True) / weight.sum(dim=1, keepdim=True).clamp_min(1.0)
