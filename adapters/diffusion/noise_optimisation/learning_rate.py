"""The learning rate of noise optimisation: a linear warm-up times half a cosine.

Source: docs/specification/dno.md#the-optimiser.
"""

from __future__ import annotations

import math


def learning_rate_factor(step: int, *, warmup: int, iterations: int) -> float:
    """Factor on the learning rate at ``step``, from 0 to 1.

    The warm-up is ``step / warmup`` and starts at 0, so that the first step of the published schedule moves nothing;
    the cosine decays over the whole run and is 0 at ``step = iterations``.

    Args:
        step: Iterations done so far.
        warmup: Iterations of the warm-up; 0 switches it off.
        iterations: Iterations of the whole run.
    """
    ramp = step / warmup if step < warmup else 1.0
    return ramp * (math.cos(math.pi * step / iterations) + 1.0) / 2.0
