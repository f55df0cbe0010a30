"""What an evaluator is trained for: reconstruction first, then contrast.

Source: docs/specification/text-to-motion-eval.md#training-the-extractor.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch.nn.functional import pairwise_distance


class EvaluatorObjective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of ``[model]`` beside those of the networks. Defaults are those of the text-to-motion paper."""

    autoencoder_batches: int = 0
    """Batches of stage ``full`` that train the movement autoencoder, before it is frozen."""
    window: int = 24
    """Frames of a clip of the autoencoder."""
    windows: int = 1
    """Clips drawn from every motion of a batch."""
    sparsity: float = 0.001
    """Weight of the mean size of the snippets' numbers."""
    smoothness: float = 0.001
    """Weight of the mean difference of neighbouring snippets."""
    margin: float = 10.0
    """Distance beyond which a wrong pair costs nothing."""
    equal_texts_are_negatives: bool = True
    """Push a motion away from another one's text even if both have the same text, as the original does."""
    words: str = ""
    """Folder of the word vectors and lists, for ``text = "glove"``."""
    text_path: str = ""
    """Folder or hub id of the text encoder, for ``text = "distilbert"``; by default that of the environment."""

    def __post_init__(self) -> None:
        if self.window < 4 or self.window % 4:
            raise ValueError("`window` must be a multiple of 4")
        if self.windows < 1 or self.autoencoder_batches < 0:
            raise ValueError("`windows` must be 1 or more, `autoencoder_batches` 0 or more")


def reconstruction_losses(
    objective: EvaluatorObjective,
    recorded: Float[torch.Tensor, "clips frames 259"],
    reconstructed: Float[torch.Tensor, "clips frames 259"],
    snippets: Float[torch.Tensor, "clips snippets width"],
    n_frames: Int[torch.Tensor, " clips"],
) -> dict[str, torch.Tensor]:
    """L1 of the valid frames, with snippets that are sparse and change smoothly.

    Returns:
        ``loss`` and its parts ``reconstruction``, ``sparsity``, ``smoothness``.
    """
    valid = torch.arange(recorded.shape[1], device=recorded.device) < n_frames[:, None]
    reconstruction = (recorded - reconstructed).abs().mean(dim=-1)[valid].mean()
    sparsity, smoothness = snippets.abs().mean(), snippets.diff(dim=1).abs().mean() if snippets.shape[1] > 1 else 0.0
    loss = reconstruction + objective.sparsity * sparsity + objective.smoothness * smoothness
    return {"loss": loss, "reconstruction": reconstruction}


def contrastive_losses(
    text: Float[torch.Tensor, "batch dimension"],
    motion: Float[torch.Tensor, "batch dimension"],
    *,
    shift: int,
    margin: float,
    counted: Bool[torch.Tensor, " batch"] | None = None,
) -> dict[str, torch.Tensor]:
    """Pull each text to its own motion, push it from the one ``shift`` rows before (1 to batch - 1).

    Args:
        text: Embeddings of the texts.
        motion: Embeddings of their motions.
        shift: 0 would pair every text with its own motion as a negative, as the reference sometimes does.
        margin: Distance beyond which a wrong pair costs nothing.
        counted: Which of the wrong pairs count; all by default.

    Returns:
        ``loss`` and its parts ``positive`` (mean D²) and ``negative`` (mean max(0, margin - D)²), and ``ranked``: the
        share of texts that are nearer to their own motion than to the wrong one.
    """
    assert 0 < shift < len(text)
    near, far = pairwise_distance(text, motion), pairwise_distance(text, motion.roll(shift, dims=0))
    positive = near.square().mean()
    wrong = (margin - far).clamp_min(0.0).square()
    if counted is not None:
        wrong = wrong * counted
    negative = wrong.mean() if counted is None else wrong.sum() / counted.sum().clamp_min(1)
    return {
        "loss": positive + negative,
        "positive": positive,
        "negative": negative,
        "ranked": (near < far).float().mean().detach(),
    }


def positive_losses(
    text: Float[torch.Tensor, "batch dimension"], motion: Float[torch.Tensor, "batch dimension"]
) -> dict[str, torch.Tensor]:
    """:func:`contrastive_losses` where there is no wrong pair."""
    positive = pairwise_distance(text, motion).square().mean()
    return {"loss": positive, "positive": positive, "negative": torch.zeros_like(positive)}


def different_texts(texts: Sequence[str], shift: int) -> Bool[torch.Tensor, " batch"]:
    """Whether each row's text differs from that of the motion ``shift`` rows before."""
    return torch.tensor([text != texts[row - shift] for row, text in enumerate(texts)])
