"""Vectors of captions for the network, each distinct text encoded once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float

from prbench.errors import UsageError
from prbench.text import TextEncoder, text_encoder

_MOST_TEXTS = 65_536
"""Kept at once; of Nymeria's narrations in DistilBERT's vectors these are about 3 GB."""


class TextVectors:
    """A frozen text encoder that remembers what it has encoded."""

    def __init__(self, encoder: TextEncoder) -> None:
        self.encoder = encoder
        self._known: dict[str, Float[np.ndarray, "tokens dimension"]] = {}

    @classmethod
    def of_model(cls, name: str, dimension: int) -> TextVectors:
        """Those of the encoder that the table ``[model]`` names.

        Args:
            name: Its ``text_encoder``.
            dimension: Its ``text_dimension``.

        Raises:
            UsageError: if there is no such encoder, or its vectors have another size.
        """
        encoder = text_encoder(name)
        if encoder.dimension != dimension:
            raise UsageError(
                f"model.text_dimension: the text encoder '{name}' has vectors of {encoder.dimension} numbers,"
                f" found {dimension}."
            )
        return cls(encoder)

    @property
    def origin(self) -> str:
        """A line for the card of weights that build upon it."""
        return f"text encoder {self.encoder.name} (frozen)"

    def __call__(
        self, texts: Sequence[str]
    ) -> tuple[Float[torch.Tensor, "texts tokens dimension"], Bool[torch.Tensor, "texts tokens"]]:
        """Token vectors, zero where there is padding, and the padding itself (True = no token), on the CPU."""
        self._learn(sorted({text for text in texts if text not in self._known}), texts)
        vectors = [self._known[text] for text in texts]
        lengths = np.array([len(tokens) for tokens in vectors])
        stacked = np.zeros((len(texts), int(lengths.max()), self.encoder.dimension), dtype=np.float32)
        for row, tokens in enumerate(vectors):
            stacked[row, : len(tokens)] = tokens
        padding = np.arange(stacked.shape[1]) >= lengths[:, None]
        return torch.from_numpy(stacked), torch.from_numpy(padding)

    def _learn(self, missing: list[str], wanted: Sequence[str]) -> None:
        if not missing:
            return
        if len(self._known) + len(missing) > _MOST_TEXTS:  # forget all but what this batch needs
            self._known = {text: self._known[text] for text in wanted if text in self._known}
        encoded = self.encoder.encode(missing)
        for text, tokens, padding in zip(missing, encoded.tokens, encoded.padding, strict=True):
            self._known[text] = tokens[~padding].copy()
