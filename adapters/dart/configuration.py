"""What a DART model is: sizes of both networks, primitives, text and diffusion; stands in the header of its weights."""

from __future__ import annotations

import msgspec

HISTORY_FRAMES = 2
"""H: the last frames of one primitive, which the next begins with; the first has those of the initial state."""

_COUNTS = (
    "future_frames", "latent", "vae_width", "vae_heads", "vae_layers", "vae_feed_forward", "width",
    "heads", "layers", "feed_forward", "text_dimension", "diffusion_steps",
)  # fmt: skip


class DartConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The networks of one model; the defaults are the original's sizes (docs/specification/dart.md#networks).

    Raises:
        ValueError: for sizes that do not fit together.
    """

    future_frames: int = 8
    """F: frames that a primitive adds."""
    latent: int = 256
    """Numbers of the latent vector of a primitive."""
    vae_width: int = 256
    vae_heads: int = 4
    vae_layers: int = 7
    """Of encoder and decoder each; odd: as many in front of the middle one as behind it."""
    vae_feed_forward: int = 1024
    width: int = 512
    heads: int = 4
    layers: int = 8
    feed_forward: int = 1024
    dropout: float = 0.1
    text_encoder: str = "distilbert"
    text_dimension: int = 768
    diffusion_steps: int = 10
    fps: float = 20.0
    uniform_skeleton: bool = False
    """Whether the model has learnt bodies that were rescaled to HumanML3D's skeleton
    (docs/specification/pr-model.md#data-and-features); conditions are then put onto it, and motions scaled back."""

    def __post_init__(self) -> None:
        for name in _COUNTS:
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if self.vae_layers % 2 == 0:
            raise ValueError(f"'vae_layers' must be odd, found {self.vae_layers}")
        if self.future_frames < HISTORY_FRAMES:
            raise ValueError(f"'future_frames' must be at least {HISTORY_FRAMES}, found {self.future_frames}")
        for width, heads in (("vae_width", "vae_heads"), ("width", "heads")):
            if getattr(self, width) % getattr(self, heads) or getattr(self, width) % 2:
                raise ValueError(f"'{width}' must be even and a multiple of '{heads}', found {getattr(self, width)}")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"'dropout' must be in [0, 1), found {self.dropout}")
        if self.fps <= 0:
            raise ValueError(f"'fps' must be positive, found {self.fps}")

    @property
    def primitive_frames(self) -> int:
        """H + F."""
        return HISTORY_FRAMES + self.future_frames

    def primitives_for(self, n_frames: int) -> int:
        """How many primitives a motion of ``n_frames`` takes, history included; the last may be longer than needed."""
        return max(1, -(-(n_frames - HISTORY_FRAMES) // self.future_frames))
