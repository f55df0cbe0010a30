"""People who act for all tests of this folder; acted out once."""

from __future__ import annotations

import functools
from collections.abc import Callable

import pytest

from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance
from tests.shapes import unchecked

N_RECORDINGS = 20


@pytest.fixture(scope="session")
def crowd() -> Callable[[str], list[Performance]]:
    """From a preset to twenty recordings of it, without provocations, at 60 Hz, acted out when first asked for."""

    @functools.cache
    def act(preset: str) -> list[Performance]:
        with unchecked():
            numbers = range(N_RECORDINGS)
            return [perform(preset, seed=3, index=n, n_events=6, rate=60.0, provocations={}) for n in numbers]

    return act


@pytest.fixture(scope="session")
def adt_120() -> Performance:
    """One ADT recording at the full rate."""
    return perform("adt", seed=5, index=2, n_events=8, provocations={})
