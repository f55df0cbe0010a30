"""What a WANDR network is made of: one frozen record, stored as JSON beside its weights."""

from __future__ import annotations

import msgspec


class WandrConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of encoder and decoder; the defaults are those of the original (docs/specification/wandr.md#network).

    Raises:
        ValueError: for sizes that are not possible.
    """

    layers: int = 14
    """Linear layers of the encoder, and of the decoder."""
    widest: int = 512
    """No hidden layer is wider; without effect on the original's sizes."""
    latent: int = 64
    dropout: float = 0.03
    fps: float = 30.0
    original_deviation: bool = False
    """Draw the latent with exp(v) as its deviation, as the public program does, though its KL divergence takes v for a
    log-variance; otherwise with exp(v / 2). Only training draws from the encoder."""

    def __post_init__(self) -> None:
        for name in ("layers", "widest", "latent"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"'dropout' must be in [0, 1), found {self.dropout}")
        if not self.fps > 0:
            raise ValueError(f"'fps' must be positive, found {self.fps}")
