"""How the condition vector p enters the memory tokens (*Prime and Reach*, sections 4.1 and D.3, equation 8).

Both ways start at zero, so that fine-tuning starts at the output of the pre-trained model.
"""

from __future__ import annotations

import math

from jaxtyping import Float
from torch import Tensor, nn, softmax, stack

from prbench_adapters.diffusion.configuration import DenoiserConfiguration


class Addition(nn.Module):
    """z̃ = z + Linear(p), the same for every memory token."""

    def __init__(self, configuration: DenoiserConfiguration) -> None:
        super().__init__()
        self.projection = nn.Linear(configuration.condition_size, configuration.width)
        nn.init.zeros_(self.projection.weight)
        nn.init.zeros_(self.projection.bias)

    def forward(
        self, tokens: Float[Tensor, "batch tokens width"], vector: Float[Tensor, "batch size"]
    ) -> Float[Tensor, "batch tokens width"]:
        """Add the projected vector to every token."""
        return tokens + self.projection(vector)[:, None]


class CrossAttentionInjection(nn.Module):
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
