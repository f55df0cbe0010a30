"""The global random generators of Python, NumPy and torch: set before a method is asked, compared afterwards."""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


def touched(before: dict[str, bytes]) -> tuple[str, ...]:
    """Whose state is another than it was."""
    return tuple(name for name, state in states().items() if before.get(name, state) != state)


def states() -> dict[str, bytes]:
    """The state of each global generator, by what a method calls to draw from it."""
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
def set_to(seed: int) -> Iterator[None]:
    """All of them seeded, and afterwards as they were."""
    python, legacy = random.getstate(), np.random.get_state()  # noqa: NPY002 - put back as it was
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
