"""Coefficients of windows as uncorrelated numbers of equal spread: what varies little is then wrong by little.

The joints of a body move together: of the 66 numbers of a coefficient a few carry nearly all of its spread. Noise and
errors of equal size in all 66 would be a body that is torn.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

_SMALLEST = 1e-3  # metres; nothing below it matters, and half precision still holds it


class Whitening(nn.Module):
    """The principal directions of the values, and the spread along each of them in each coefficient.

    Args:
        coefficients: DCT coefficients of a window.
        values: Numbers of one coefficient.
    """

    def __init__(self, coefficients: int, values: int) -> None:
        super().__init__()
        self.register_buffer("directions", torch.eye(values))
        self.register_buffer("spread", torch.ones(coefficients, values))
        self.directions: Tensor
        """Column j is direction j."""
        self.spread: Tensor
        """Root mean square along each direction, metres."""

    @torch.no_grad()
    def take(self, coefficients: Float[Tensor, "windows coefficients values"]) -> None:
        """Measure directions and spread on coefficients of training windows."""
        flat = coefficients.flatten(0, 1).double()
        directions = torch.linalg.eigh(flat.T @ flat / len(flat)).eigenvectors.flip(1)
        spread = (coefficients.double() @ directions).square().mean(dim=0).sqrt()
        self.directions.copy_(directions)
        self.spread.copy_(spread.clamp_min(_SMALLEST))

    def forward(self, coefficients: Float[Tensor, "*batch coefficients values"]) -> Tensor:
        """Whiten coefficients."""
        # The inverse of what :meth:`inverse` uses: directions that were kept in half precision are not orthogonal.
        back = torch.linalg.inv(self.directions.double()).to(coefficients.dtype)
        return coefficients @ back.T / self.spread.to(coefficients.dtype)

    def inverse(self, whitened: Float[Tensor, "*batch coefficients values"]) -> Tensor:
        """Turn whitened coefficients back into metres."""
        return (whitened * self.spread.to(whitened.dtype)) @ self.directions.T.to(whitened.dtype)
