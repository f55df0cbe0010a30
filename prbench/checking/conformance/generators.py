"""The global generators of Python, NumPy and torch: what a method draws from and must leave alone."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


def generators_touched(before: dict[str, bytes]) -> tuple[str, ...]:
    """Return the names of the generators whose state differs from ``before``."""
    return tuple(name for name, state in generator_states().items() if before.get(name, state) != state)


def generator_states() -> dict[str, bytes]:
    """Map the name of each global generator to its state."""
    # The key changes every 624 draws only; the place in it changes with each.
    _, key, *place = np.random.get_state(legacy=True)  # noqa: NPY002 - only looked at
    found = {
        "random": repr(random.getstate()).encode(),
        "numpy.random": np.asarray(key).tobytes() + repr(place).encode(),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "random"):
        found["torch"] = torch.random.get_rng_state().numpy().tobytes()
    return found


@contextmanager
def generators_set_to(seed: int) -> Iterator[None]:
    """Seed all global generators, and restore their states at the end."""
    python = random.getstate()
    legacy = np.random.get_state()  # noqa: NPY002 - put back as it was
    torch = sys.modules.get("torch")
    drawn = torch.random.get_rng_state() if torch is not None and hasattr(torch, "random") else None
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - a method that draws from it is found out by another seed
    if torch is not None and drawn is not None:
        torch.random.manual_seed(seed)
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(legacy)  # noqa: NPY002 - put back as it was
        if torch is not None and drawn is not None:
            torch.random.set_rng_state(drawn)
