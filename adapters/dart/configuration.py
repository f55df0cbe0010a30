"""Sizes of a DART model, settings of its motions, and the options that change them (``--option key=value``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast

import msgspec

from prbench_adapters.diffusion.noise_optimisation.settings import Hand
from prbench_adapters.diffusion.options import choice, number, whole_number

HISTORY_FRAMES = 2
"""H: the last frames of one primitive, which the next begins with; the first has those of the initial state."""

_COUNTS = (
    "future_frames", "latent", "vae_width", "vae_heads", "vae_layers", "vae_feed_forward", "width",
    "heads", "layers", "feed_forward", "text_dimension", "diffusion_steps",
)  # fmt: skip
GradientNorm = Literal["sequence", "batch"]
_Seeding = Literal["velocity", "repeat"]
_OF_OPTIMISATION = (
    "iterations", "learning-rate", "noise-scale", "ddim-steps", "gradient-norm", "hand", "jerk", "floor",
    "checkpointing",
)  # fmt: skip
OPTIONS = ("optimise", *_OF_OPTIMISATION, "guidance", "seeding", "text-path")
_MOST_ITERATIONS = 100_000


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
    """Layers of encoder and decoder each; odd: as many in front of the middle one as behind it."""
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
    """True for a model that has learnt bodies that were rescaled to HumanML3D's skeleton
    (docs/specification/pr-model.md#data-and-features); conditions are then put onto it, and motions scaled back."""

    def __post_init__(self) -> None:
        for name in _COUNTS:
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        # Skips join each layer in front of the middle one to a layer behind it.
        if self.vae_layers % 2 == 0:
            raise ValueError(f"'vae_layers' must be odd, found {self.vae_layers}")
        if self.future_frames < HISTORY_FRAMES:
            raise ValueError(f"'future_frames' must be at least {HISTORY_FRAMES}, found {self.future_frames}")
        for width, heads in (("vae_width", "vae_heads"), ("width", "heads")):
            # Even, because the table of sinusoids pairs sines with cosines.
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
        """Count the primitives of a motion of ``n_frames``, history included; the last may be longer than needed."""
        return max(1, -(-(n_frames - HISTORY_FRAMES) // self.future_frames))


@dataclass(frozen=True, kw_only=True)
class DartSettings:
    """Settings of generation; the defaults are those of the study's comparison.

    Source: docs/specification/dart.md#conditions-in-the-study.
    """

    optimised: bool = True
    """Optimise the noise towards the goal; otherwise the goal is not looked at."""
    iterations: int = 100
    """*Prime and Reach*, section 5.3."""
    learning_rate: float = 0.05
    """Learning rate of Adam in the first iteration; falls linearly, to a hundredth of it in the last of 100."""
    noise_scale: float = 0.1
    """Standard deviation of the noise that optimisation starts from (the original's setting for in-betweening)."""
    ddim_steps: int | None = None
    """Steps of the chain from noise to latent; None for all of the training's, as in the original."""
    guidance: float = 5.0
    gradient_norm: GradientNorm = "sequence"
    """Gradient that is brought to length 1 in each primitive: each sequence's, or that of the whole batch, with which
    the original lets the sequences of a batch slow each other down."""
    seeding: _Seeding = "velocity"
    """Take as history the frame before the first and the first, or twice the first: a body at rest."""
    hand: Hand = "right"
    """Wrist that a goal location is meant for; ``nearest`` leaves the choice to the motion."""
    jerk_weight: float = 0.0
    """Weight of the largest third difference, metres per frame³; 0 in the original's in-betweening."""
    floor_weight: float = 0.0
    """Weight of the mean depth of the feet below their height in the frame before the first, metres; likewise 0."""
    checkpointing: bool = False
    """Compute a primitive again in the backward pass instead of keeping it in memory."""

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"'iterations': expected 1 or more, found {self.iterations}.")


def dart_settings(options: Mapping[str, str], *, diffusion_steps: int) -> DartSettings:
    """The settings that options ask for.

    Args:
        options: As given.
        diffusion_steps: Steps that the model was trained with.

    Raises:
        ValueError: naming an option that has an impossible value, or does not go with another.
    """
    default = DartSettings()
    optimised = choice(options, "optimise", ("on", "off")) == "on"
    # An option that changes nothing is a mistake of the user, who must hear of it.
    idle = [] if optimised else [key for key in _OF_OPTIMISATION if key in options]
    if idle:
        raise ValueError(f"option '{idle[0]}' belongs to noise optimisation; choose optimise=on.")
    return DartSettings(
        optimised=optimised,
        iterations=whole_number(options, "iterations", most=_MOST_ITERATIONS) or default.iterations,
        learning_rate=number(options, "learning-rate", default.learning_rate),
        noise_scale=number(options, "noise-scale", default.noise_scale),
        ddim_steps=whole_number(options, "ddim-steps", most=diffusion_steps),
        guidance=number(options, "guidance", default.guidance),
        gradient_norm=cast(GradientNorm, choice(options, "gradient-norm", ("sequence", "batch"))),
        seeding=cast(_Seeding, choice(options, "seeding", ("velocity", "repeat"))),
        hand=cast(Hand, choice(options, "hand", ("right", "nearest", "left"))),
        jerk_weight=number(options, "jerk", default.jerk_weight),
        floor_weight=number(options, "floor", default.floor_weight),
        checkpointing=choice(options, "checkpointing", ("off", "on")) == "on",
    )
