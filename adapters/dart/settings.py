"""How DartControl's motions are made, and the options that say so (``--option key=value``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast

from prbench_adapters.diffusion.noise_optimisation.settings import Hand
from prbench_adapters.diffusion.options import choice, number, whole_number

GradientNorm = Literal["sequence", "batch"]
Seeding = Literal["velocity", "repeat"]

_OF_OPTIMISATION = (
    "iterations", "learning-rate", "noise-scale", "ddim-steps", "gradient-norm", "hand", "jerk", "floor",
    "checkpointing",
)  # fmt: skip
OPTIONS = ("optimise", *_OF_OPTIMISATION, "guidance", "seeding", "text-path")
_MOST_ITERATIONS = 100_000


@dataclass(frozen=True, kw_only=True)
class DartSettings:
    """Settings of generation; the defaults are those of the study's comparison.

    Source: docs/specification/dart.md#conditions-in-the-study.
    """

    optimised: bool = True
    """Whether the noise is optimised towards the goal; otherwise the goal is not looked at."""
    iterations: int = 100
    """*Prime and Reach*, section 5.3."""
    learning_rate: float = 0.05
    """Of Adam in the first iteration; falls linearly, to a hundredth of it in the last of 100."""
    noise_scale: float = 0.1
    """Standard deviation of the noise that optimisation starts from (the original's setting for in-betweening)."""
    ddim_steps: int | None = None
    """Of the chain from noise to latent; None for all of the training's, as in the original."""
    guidance: float = 5.0
    gradient_norm: GradientNorm = "sequence"
    """Whose gradient is brought to length 1 in each primitive: each sequence's, or that of the whole batch, with which
    the original lets the sequences of a batch slow each other down."""
    seeding: Seeding = "velocity"
    """Whether the history is the frame before the first and the first, or twice the first: a body at rest."""
    hand: Hand = "right"
    """Wrist that a goal location is meant for; ``nearest`` leaves the choice to the motion."""
    jerk_weight: float = 0.0
    """Of the largest third difference, metres per frame³; 0 in the original's in-betweening."""
    floor_weight: float = 0.0
    """Of the mean depth of the feet below where they are in the frame before the first, metres; likewise 0."""
    checkpointing: bool = False
    """Whether a primitive is computed again in the backward pass instead of kept in memory."""

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
        seeding=cast(Seeding, choice(options, "seeding", ("velocity", "repeat"))),
        hand=cast(Hand, choice(options, "hand", ("right", "nearest", "left"))),
        jerk_weight=number(options, "jerk", default.jerk_weight),
        floor_weight=number(options, "floor", default.floor_weight),
        checkpointing=choice(options, "checkpointing", ("off", "on")) == "on",
    )
