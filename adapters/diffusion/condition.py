"""Conditions as a denoiser takes them: encoded text, and the vector of initial state and goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float


@dataclass(frozen=True)
class EncodedCondition:
    """What B motions are conditioned on."""

    text: Float[torch.Tensor, "batch tokens dimension"]
    """Vectors of the frozen text encoder, one per word piece."""
    padding: Bool[torch.Tensor, "batch tokens"]
    """True where a row has no word piece. The first token of a row always counts, so that no row is without any."""
    vector: Float[torch.Tensor, "batch size"] | None = None
    """Initial pose, initial velocity and goal, scaled (docs/specification/pr-model.md#network); None without a goal."""

    def __len__(self) -> int:
        return len(self.text)

    def without_text(self) -> EncodedCondition:
        """The unconditional half of guidance: zeros for the text vectors; its padding and the vector stay."""
        return replace(self, text=torch.zeros_like(self.text))

    def rows(self, index: slice | Sequence[int] | torch.Tensor) -> EncodedCondition:
        """Some of the motions, in the order of ``index``."""
        vector = None if self.vector is None else self.vector[index]
        return EncodedCondition(self.text[index], self.padding[index], vector)

    def then(self, other: EncodedCondition) -> EncodedCondition:
        """These motions and those of ``other`` as one batch; both have the same number of tokens.

        Raises:
            ValueError: if only one of the two has a vector.
        """
        if (self.vector is None) is not (other.vector is None):
            raise ValueError("conditions with and without a vector cannot share a batch")
        vector = None if self.vector is None or other.vector is None else torch.cat([self.vector, other.vector])
        return EncodedCondition(torch.cat([self.text, other.text]), torch.cat([self.padding, other.padding]), vector)

    def to(self, device: torch.device | str) -> EncodedCondition:
        """The same on another device."""
        vector = None if self.vector is None else self.vector.to(device)
        return EncodedCondition(self.text.to(device), self.padding.to(device), vector)
