"""Options of noise optimisation, shared by the methods that use it (``--option key=value``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast, get_args

from prbench_adapters.diffusion.noise_optimisation.settings import Bones, Hand, Keep, OptimisationSettings, Precision
from prbench_adapters.diffusion.options import choice, number, whole_number
from prbench_adapters.diffusion.schedule import Spacing

_SHARED = (
    "ddim-steps",
    "spacing",
    "iterations",
    "learning-rate",
    "decorrelation",
    "hand",
    "bones",
    "keep",
    "stop-below",
    "checkpointing",
    "precision",
    "compile",
)
PRIME_AND_REACH_OPTIONS = (*_SHARED, "alpha", "initial-velocity-weight")
"""With the objective of :func:`~prbench_adapters.diffusion.noise_optimisation.prime_and_reach`."""
KEYFRAME_OPTIONS = (*_SHARED, "initial-frames")
"""With the objective of :func:`~prbench_adapters.diffusion.noise_optimisation.keyframes`."""
_MOST_ITERATIONS = 100_000


def optimisation_settings(
    options: Mapping[str, str], preset: OptimisationSettings, *, diffusion_steps: int
) -> OptimisationSettings:
    """A preset with the options that were given; the warm-up keeps its share of the iterations.

    Args:
        options: As given; keys that are in neither list above are not looked at.
        preset: What holds for options that are not given.
        diffusion_steps: Steps that the model was trained with.

    Raises:
        ValueError: naming the option with a value that is not possible.
    """
    iterations = whole_number(options, "iterations", most=_MOST_ITERATIONS) or preset.iterations
    blocks = whole_number(options, "checkpointing", most=diffusion_steps) if options.get("checkpointing") != "0" else 0
    return replace(
        preset,
        ddim_steps=whole_number(options, "ddim-steps", most=diffusion_steps) or preset.ddim_steps,
        spacing=cast(Spacing, _one_of(options, "spacing", preset.spacing, get_args(Spacing))),
        iterations=iterations,
        warmup=round(preset.warmup * iterations / preset.iterations),
        learning_rate=number(options, "learning-rate", preset.learning_rate),
        jerk_weight=number(options, "alpha", preset.jerk_weight),
        decorrelation_weight=number(options, "decorrelation", preset.decorrelation_weight),
        initial_velocity_weight=number(options, "initial-velocity-weight", preset.initial_velocity_weight),
        initial_frames=whole_number(options, "initial-frames", most=2) or preset.initial_frames,
        hand=cast(Hand, _one_of(options, "hand", preset.hand, get_args(Hand))),
        bones=cast(Bones, _one_of(options, "bones", preset.bones, get_args(Bones))),
        keep=cast(Keep, _one_of(options, "keep", preset.keep, get_args(Keep))),
        stop_below=number(options, "stop-below", 0.0) if "stop-below" in options else preset.stop_below,
        checkpointing=preset.checkpointing if blocks is None else blocks,
        precision=cast(Precision, _one_of(options, "precision", preset.precision, get_args(Precision))),
        compiled=_one_of(options, "compile", "true" if preset.compiled else "false", ("false", "true")) == "true",
    )


def _one_of(options: Mapping[str, str], key: str, default: str, values: tuple[str, ...]) -> str:
    return choice(options, key, values) if key in options else default
