"""The mean of a metric over repetitions, with its interval (docs/specification/text-to-motion-eval.md#metrics)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Repeated:
    """One number over repetitions of the whole evaluation. The interval says how far chance moves the mean of these
    repetitions; it knows nothing of the choice of recordings or of training.
    """  # noqa: D205

    mean: float
    half_width: float | None
    """1.96 · population standard deviation / √repetitions; None for a single one."""
    values: tuple[float, ...]
    """One a repetition."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Repeated:
        """Summarise the values of at least one repetition."""
        numbers = np.asarray(values, dtype=np.float64)
        half = 1.96 * float(numbers.std()) / float(np.sqrt(len(numbers))) if len(numbers) > 1 else None
        return cls(float(numbers.mean()), half, tuple(float(number) for number in numbers))
