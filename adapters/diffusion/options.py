"""Options of the diffusion methods, as they come from ``--option key=value``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from prbench.errors import did_you_mean
from prbench_adapters.diffusion.generation import SamplingSettings

SAMPLING_OPTIONS = ("guidance", "sampler", "steps", "precision")
ONE_PASS = "one-pass"
SAMPLERS = ("ddpm", "ddim")
_PRECISIONS = ("float32", "bfloat16")


def require_known(options: Mapping[str, str], known: Iterable[str]) -> None:
    """Refuse options that a method does not have.

    Raises:
        ValueError: naming the nearest one, and all.
    """
    names = list(dict.fromkeys(known))
    for key in options:
        if key not in names:
            hint = did_you_mean(key, names)
            raise ValueError(f"unknown option '{key}'.{hint} Known options: {', '.join(names)}.")


def number(options: Mapping[str, str], key: str, default: float, *, least: float = 0.0) -> float:
    """A finite number of at least ``least``.

    Raises:
        ValueError: naming the option.
    """
    text = options.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        raise ValueError(f"option '{key}': expected a number of {least:g} or more, found '{text}'.")
    return value


def whole_number(options: Mapping[str, str], key: str, *, most: int) -> int | None:
    """A whole number from 1 to ``most``; None if the option is not given.

    Raises:
        ValueError: naming the option.
    """
    text = options.get(key)
    if text is None:
        return None
    # int() alone would also take ` 5`, `1_000` and digits of other scripts.
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= most):
        raise ValueError(f"option '{key}': expected a whole number from 1 to {most}, found '{text}'.")
    return int(text)


def choice(options: Mapping[str, str], key: str, values: tuple[str, ...], default: str | None = None) -> str:
    """Return one of ``values``; if the option is not given the default, which is the first unless another is named.

    Raises:
        ValueError: naming the option.
    """
    value = options.get(key, values[0] if default is None else default)
    if value not in values:
        raise ValueError(f"option '{key}': expected {' or '.join(values)}, found '{value}'.")
    return value


def sampling_settings(
    options: Mapping[str, str], *, guidance: float, diffusion_steps: int, samplers: tuple[str, ...] = SAMPLERS
) -> SamplingSettings:
    """The options ``guidance``, ``sampler``, ``steps`` and ``precision``; ``one-pass`` walks as ``ddim`` does.

    Args:
        options: As given.
        guidance: Of the method, unless given.
        diffusion_steps: Steps that the model was trained with.
        samplers: Values of ``sampler`` that the method has, its default first.

    Raises:
        ValueError: naming the option with a value that is not possible.
    """
    return SamplingSettings(
        guidance=number(options, "guidance", guidance),
        sampler="ddpm" if choice(options, "sampler", samplers) == "ddpm" else "ddim",
        steps=whole_number(options, "steps", most=diffusion_steps),
        precision="bfloat16" if choice(options, "precision", _PRECISIONS) == "bfloat16" else "float32",
    )
