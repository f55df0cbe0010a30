"""People who act for all tests of this folder; acted out once."""

from __future__ import annotations

import pytest

from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.performance import Performance
from tests.shapes import unchecked

N_RECORDINGS = 20


@pytest.fixture(scope="session")
def crowds() -> dict[str, list[Performance]]:
    """Twenty recordings of every preset, without provocations, at 60 Hz."""
    with unchecked():
        return {preset: [_act(preset, index) for index in range(N_RECORDINGS)] for preset in PRESETS}


def _act(preset: str, index: int) -> Performance:
    return perform(preset, seed=3, index=index, n_events=6, rate=60.0, provocations={})


@pytest.fixture(scope="session")
def adt_120() -> Performance:
    """One ADT recording at the full rate."""
    return perform("adt", seed=5, index=2, n_events=8, provocations={})
