"""The learning rate of every step, a pure function of the step."""

from __future__ import annotations

import math

from prbench.training.configuration import OptimisationConfiguration


def learning_rate(step: int, settings: OptimisationConfiguration) -> float:
    """Linear warm-up, then constant or a half cosine that would reach 0 one step after the last.

    Args:
        step: From 0 on.
        settings: Peak rate, schedule, warm-up and number of steps.
    """
    if step < settings.warmup_steps:
        return settings.learning_rate * (step + 1) / settings.warmup_steps
    if settings.schedule == "constant":
        return settings.learning_rate
    progress = (step - settings.warmup_steps) / (settings.steps - settings.warmup_steps)
    return settings.learning_rate * 0.5 * (1 + math.cos(math.pi * progress))
