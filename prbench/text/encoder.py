"""The form of encoded text: one vector a token, padded to the longest text of the batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class EncodedText:
    """The token vectors of some texts."""

    tokens: Float[np.ndarray, "texts tokens dimension"]
    """float32; zero where there is padding."""
    padding: Bool[np.ndarray, "texts tokens"]
    """True where a text has no token. Every text has at least one token."""


@runtime_checkable
class TextEncoder(Protocol):
    """Frozen: the same text always has the same vectors, whatever stands beside it in a batch."""

    @property
    def name(self) -> str:
        """Name by which weights that were trained with these vectors call them."""
        ...

    @property
    def dimension(self) -> int:
        """Length of a token vector."""
        ...

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The token vectors of some texts (at least one)."""
        ...


def padded(texts: Sequence[Float[np.ndarray, "_ dimension"]], dimension: int) -> EncodedText:
    """Stack the token vectors of texts of different lengths.

    Args:
        texts: The vectors of each text (tokens, dimension); at least one token each.
        dimension: Length of a vector.
    """
    lengths = np.array([len(vectors) for vectors in texts], dtype=np.int64)
    longest = int(lengths.max(initial=1))
    tokens = np.zeros((len(texts), longest, dimension), dtype=np.float32)
    for row, vectors in enumerate(texts):
        tokens[row, : len(vectors)] = vectors
    return EncodedText(tokens, np.arange(longest) >= lengths[:, None])
