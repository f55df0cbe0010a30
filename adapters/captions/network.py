"""TM2T's transformer from motion tokens to words, its loss and its ways of decoding.

Source: docs/specification/captions.md#captioner. Parameters have the names of the public program.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench_adapters.diffusion.denoiser import sinusoid_table
from prbench_adapters.training.configuration import require_within

Tokens = Int[Tensor, "batch length"]
Stream = Float[Tensor, "batch length width"]
Memory = Float[Tensor, "batch places width"]
Seen = Bool[Tensor, "#batch 1 _ _"]
_NORM = 1e-6
_ATTENTION_DROPOUT = 0.1  # whatever the dropout elsewhere is
_LENGTH_POWER = 0.7  # of beam search: by it a score is divided


class CaptionerConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the network; as published by default.

    Attributes:
        codes: Number of different motion tokens; training takes it from the tokens.
        pieces: Number of pieces of text; training takes it from the vocabulary.
        words: The vocabulary of ``text = "words"``, by place; training takes it from the texts.
        text: ``words`` of the training texts, or the pieces of ``gpt2``.
        inner: Width inside the feed-forward layers.
        head_width: Width of a head, whatever the network's.
        dropout: Dropout of what each layer adds.
        smoothing: Share of a word's probability that all others are given in training.
        longest: Most tokens of a motion, and most pieces of a caption, besides start and end.
    """

    codes: int = 0
    pieces: int = 0
    words: tuple[str, ...] = ()
    text: Literal["words", "gpt2"] = "words"
    width: int = 512
    inner: int = 2048
    layers: int = 4
    heads: int = 8
    head_width: int = 64
    dropout: float = 0.1
    smoothing: float = 0.0
    longest: int = 160

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "width", "inner", "layers", "heads", "head_width", "longest")
        require_within(self, "at least 0 and below 1", "dropout", "smoothing")
        if self.width % 2:
            raise ValueError(f"'width' must be even, found {self.width}")


class Attention(nn.Module):
    """Post-norm attention with heads of any width."""

    def __init__(self, shape: CaptionerConfiguration) -> None:
        super().__init__()
        inner = shape.heads * shape.head_width
        self.heads = shape.heads
        self.w_qs, self.w_ks, self.w_vs = (nn.Linear(shape.width, inner) for _ in range(3))
        self.fc = nn.Linear(inner, shape.width)
        self.layer_norm = nn.LayerNorm(shape.width, eps=_NORM)
        self.dropout = nn.Dropout(shape.dropout)

    def forward(self, stream: Stream, memory: Memory, seen: Seen) -> Stream:
        """Return ``stream`` with what it reads in ``memory``, where that may be seen."""
        projected = (self.w_qs(stream), self.w_ks(memory), self.w_vs(memory))
        split = [each.unflatten(-1, (self.heads, -1)).transpose(1, 2) for each in projected]
        chance = _ATTENTION_DROPOUT if self.training else 0.0
        found = functional.scaled_dot_product_attention(*split, attn_mask=seen, dropout_p=chance)
        return self.layer_norm(stream + self.dropout(self.fc(found.transpose(1, 2).flatten(2))))


class FeedForward(nn.Module):
    """Post-norm feed-forward layer."""

    def __init__(self, shape: CaptionerConfiguration) -> None:
        super().__init__()
        self.w_1 = nn.Linear(shape.width, shape.inner)
        self.w_2 = nn.Linear(shape.inner, shape.width)
        self.layer_norm = nn.LayerNorm(shape.width, eps=_NORM)
        self.dropout = nn.Dropout(shape.dropout)

    def forward(self, stream: Stream) -> Stream:
        """Return ``stream`` after the layer."""
        return self.layer_norm(stream + self.dropout(self.w_2(functional.relu(self.w_1(stream)))))


class Captioner(nn.Module):
    """Encoder of motion tokens and decoder of text, whose output matrix is the embedding of the text.

    The ids of motions are their tokens, then start, end and padding; those of texts are their pieces, then the same
    three.
    """

    def __init__(self, configuration: CaptionerConfiguration) -> None:
        super().__init__()
        shape = self.configuration = configuration
        self.source_padding, self.padding = shape.codes + 2, shape.pieces + 2

        def part(name: str, padding: int, *attentions: str) -> Any:
            layers = nn.ModuleList()
            for _ in range(shape.layers):
                inside: dict[str, nn.Module] = {each: Attention(shape) for each in attentions}
                layers.append(nn.ModuleDict(inside | {"pos_ffn": FeedForward(shape)}))
            embedding = nn.Embedding(padding + 1, shape.width, padding_idx=padding)
            return nn.ModuleDict({name: embedding, "layer_stack": layers})

        self.encoder = part("src_word_emb", self.source_padding, "slf_attn")
        self.decoder = part("trg_word_emb", self.padding, "slf_attn", "enc_attn")
        for parameter in self.parameters():
            if parameter.ndim > 1:
                nn.init.xavier_uniform_(parameter)  # the rows of the padding, too

    def encode(self, source: Tokens) -> tuple[Stream, Seen]:
        """Return the memory of motions, and which of its places are none of padding."""
        seen = (source != self.source_padding)[:, None, None]
        stream = self._embedded(self.encoder["src_word_emb"], source)
        for layer in self.encoder["layer_stack"]:
            stream = layer["pos_ffn"](layer["slf_attn"](stream, stream, seen))
        return stream, seen

    def decode(
        self, target: Tokens, memory: Memory, memory_seen: Seen, seen: Seen | None = None
    ) -> Float[Tensor, "batch length ids"]:
        """Return the logits of the id that follows each place.

        Args:
            target: Ids of the texts from their start on.
            memory: What :meth:`encode` returned.
            memory_seen: What it returned beside it.
            seen: Which places of the target may be seen beside those that come first; all while a text is written.
        """
        length = target.shape[1]
        earlier = torch.ones(length, length, dtype=torch.bool, device=target.device).tril()[None, None]
        visible = earlier if seen is None else earlier & seen
        stream = self._embedded(self.decoder["trg_word_emb"], target)
        for layer in self.decoder["layer_stack"]:
            stream = layer["enc_attn"](layer["slf_attn"](stream, stream, visible), memory, memory_seen)
            stream = layer["pos_ffn"](stream)
        return functional.linear(stream, self.decoder["trg_word_emb"].weight)

    def forward(self, source: Int[Tensor, "batch places"], target: Tokens) -> Float[Tensor, "batch length ids"]:
        """Return the logits of the id that follows each place of the texts."""
        return self.decode(target, *self.encode(source), (target != self.padding)[:, None, None])

    def _embedded(self, embedding: nn.Embedding, ids: Tokens) -> Stream:
        width = self.configuration.width
        return embedding(ids) * math.sqrt(width) + sinusoid_table(ids.shape[1], width).to(embedding.weight)


def caption_losses(
    logits: Float[Tensor, "batch length ids"], wanted: Tokens, padding: int, smoothing: float = 0.0
) -> dict[str, Tensor]:
    """Return the cross-entropy, summed over ids that are no padding, and how many ids there and how many are right.

    Args:
        logits: Logits of the network.
        wanted: The ids that should follow.
        padding: Id of the padding.
        smoothing: Share of the probability that all other ids are wanted with.
    """
    chances = logits.float().log_softmax(-1)
    own = -chances.gather(-1, wanted[..., None])[..., 0]
    others = (-chances.sum(-1) - own) / (logits.shape[-1] - 1)
    counted = wanted != padding
    loss = ((1 - smoothing) * own + smoothing * others)[counted].sum()
    right = (logits.argmax(-1) == wanted)[counted].sum()
    return {"loss": loss, "right": right, "pieces": counted.sum()}


@torch.inference_mode()
def greedy(network: Captioner, source: Int[Tensor, "batch _"], *, start: int, end: int, longest: int) -> Tokens:
    """Write the likeliest id after the other, until all texts have ended.

    Args:
        network: The network in evaluation mode.
        source: Motions with start and end.
        start: First id of a text.
        end: Last id of a text; a text that has ended is filled with it.
        longest: Most ids behind the start.

    Returns:
        The ids, start included.
    """
    memory = network.encode(source)
    tokens = source.new_full((len(source), 1), start)
    ended = tokens[:, 0] == end
    while tokens.shape[1] <= longest and not bool(ended.all()):
        following = network.decode(tokens, *memory)[:, -1].argmax(-1)
        tokens = torch.cat([tokens, torch.where(ended, end, following)[:, None]], dim=1)
        ended |= following == end
    return tokens


@torch.inference_mode()
def beam_search(
    network: Captioner, source: Int[Tensor, "1 _"], width: int, *, start: int, end: int, longest: int
) -> Int[Tensor, " ids"]:
    """Write the text of one motion by beam search.

    A text that has ended goes on like the others, and what stands behind its end counts in its score. Once all of them
    hold an end, the best is that of the highest Σ log p / length^0.7; if they never do, it is the likeliest.

    Args:
        network: The network in evaluation mode.
        source: The motion with start and end.
        width: Number of texts that are kept.
        start: First id of a text.
        end: Last id of a text.
        longest: Most ids behind the start.

    Returns:
        The ids, start and end included.
    """
    memory = network.encode(source.expand(width, -1))
    tokens = source.new_full((width, 1), start)
    scores = torch.full((width,), -math.inf, device=source.device)
    scores[0] = 0.0  # at first all beams are the same one
    ended = tokens == end
    for _ in range(longest):
        chances = network.decode(tokens, *memory)[:, -1].float().log_softmax(-1) + scores[:, None]
        scores, places = chances.flatten().topk(width)
        follow, following = places // chances.shape[1], places % chances.shape[1]
        tokens = torch.cat([tokens[follow], following[:, None]], dim=1)
        ended = (tokens == end).cumsum(1) > 0
        if bool(ended[:, -1].all()):
            break
    lengths = (~ended).sum(1) + ended[:, -1].int()
    best = int((scores / lengths**_LENGTH_POWER).argmax()) if bool(ended[:, -1].all()) else 0
    return tokens[best, : int(lengths[best])]
