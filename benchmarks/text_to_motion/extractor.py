"""Networks, normalisation and text vectors as one object: what embeds motions and texts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Float, Int

from prbench.representation import Statistics
from prbench.text import EncodedText
from prbench.text import TextEncoder as TokenVectors
from prbench_benchmarks.text_to_motion.networks import (
    MOVEMENT_FEATURES,
    SNIPPET,
    EvaluatorConfiguration,
    MotionEncoder,
    MovementEncoder,
    TextEncoder,
)

BATCH = 128


class Extractor:
    """Embeds motions and texts with its own statistics: every evaluator input goes through here, and only here.

    Args:
        configuration: Sizes and representation.
        movement: Encoder of snippets.
        motion: Encoder of motions.
        text: Encoder of texts.
        statistics: Already weighted for an evaluator (:meth:`prbench.representation.Statistics.for_evaluator`).
        tokens: Vectors of the words of a text.
        device: Where the networks run.
    """

    def __init__(
        self,
        configuration: EvaluatorConfiguration,
        movement: MovementEncoder,
        motion: MotionEncoder,
        text: TextEncoder,
        *,
        statistics: Statistics,
        tokens: TokenVectors,
        device: str = "cpu",
    ) -> None:
        self.configuration, self.statistics, self.tokens, self.device = configuration, statistics, tokens, device
        self.movement, self.motion, self.text = (
            network.eval().requires_grad_(False).to(device) for network in (movement, motion, text)
        )

    @torch.inference_mode()
    def embed_motions(self, features: Sequence[Float[np.ndarray, "_ 263"]]) -> Float[np.ndarray, "motions dimension"]:
        """One embedding a motion, float32.

        Args:
            features: Raw features of each motion, 4 frames or more; what exceeds a multiple of 4 is left out.

        Raises:
            ValueError: if a motion is shorter than 4 or longer than ``max_frames`` frames.
        """
        lengths = np.array([len(rows) for rows in features], dtype=np.int64)
        for row in np.flatnonzero((lengths < SNIPPET) | (lengths > self.configuration.max_frames)):
            limits = f"{SNIPPET} to {self.configuration.max_frames}"
            raise ValueError(f"motion {row}: expected {limits} frames, found {lengths[row]}")
        snippets = lengths // SNIPPET
        embeddings = np.empty((len(lengths), self.configuration.embedding), dtype=np.float32)
        for rows in _similar(snippets):
            standardised = _standardised([features[row] for row in rows], snippets[rows], self.statistics)
            counts = torch.from_numpy(snippets[rows]).to(self.device)
            steps = self.movement(torch.from_numpy(standardised).to(self.device), counts * SNIPPET)
            embedded = self.motion(steps, counts)
            embeddings[rows] = embedded.float().cpu().numpy()
        return embeddings

    @torch.inference_mode()
    def embed_texts(self, texts: Sequence[str]) -> Float[np.ndarray, "texts dimension"]:
        """One embedding a text, float32."""
        embeddings = np.empty((len(texts), self.configuration.embedding), dtype=np.float32)
        for start in range(0, len(texts), BATCH):
            tokens, lengths = cut_tokens(self.tokens.encode(texts[start : start + BATCH]), self.configuration)
            embedded = self.text(tokens.to(self.device), lengths)
            embeddings[start : start + len(tokens)] = embedded.float().cpu().numpy()
        return embeddings


def cut_tokens(
    encoded: EncodedText, configuration: EvaluatorConfiguration
) -> tuple[Float[torch.Tensor, "texts tokens dimension"], Int[torch.Tensor, " texts"]]:
    """Token vectors as tensors, and how many each text has: at most ``most_tokens``."""
    lengths = np.minimum((~encoded.padding).sum(axis=1), configuration.most_tokens)
    longest = int(lengths.max(initial=1))
    return torch.from_numpy(encoded.tokens[:, :longest]), torch.from_numpy(lengths)


def _similar(lengths: Int[np.ndarray, " n"]) -> Iterator[Int[np.ndarray, " rows"]]:
    """Rows in batches of similar length."""
    # Similar lengths together: batches differ in padding, never in what they embed.
    order = np.argsort(lengths, kind="stable")
    for start in range(0, len(order), BATCH):
        yield order[start : start + BATCH]


def _standardised(
    features: Sequence[Float[np.ndarray, "_ 263"]], snippets: Int[np.ndarray, " n"], statistics: Statistics
) -> Float[np.ndarray, "n frames 259"]:
    """Drop the contacts, standardise, then pad with zeros to the longest."""
    batch = np.zeros((len(features), int(snippets.max()) * SNIPPET, MOVEMENT_FEATURES), dtype=np.float32)
    for row, (motion, count) in enumerate(zip(features, snippets)):
        kept = statistics.standardise(motion[: count * SNIPPET])
        batch[row, : count * SNIPPET] = kept[:, :MOVEMENT_FEATURES]
    return batch
