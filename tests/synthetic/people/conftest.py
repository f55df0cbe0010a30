"""People who act for all tests of this folder; acted out once."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import pytest

from prbench.synthetic.people import PRESETS, perform
from prbench.synthetic.performance import Performance
from tests.shapes import unchecked

N_RECORDINGS = 20


class Crowds(Mapping[str, list[Performance]]):
    """Twenty recordings of every preset, each preset's acted out when it is first asked for.

    Two processes share the tests, and only some tests look at every preset.
    """

    def __init__(self) -> None:
        self._acted: dict[str, list[Performance]] = {}

    def __getitem__(self, preset: str) -> list[Performance]:
        if preset not in self._acted:
            with unchecked():
                self._acted[preset] = [_act(preset, index) for index in range(N_RECORDINGS)]
        return self._acted[preset]

    def __iter__(self) -> Iterator[str]:
        return iter(PRESETS)

    def __len__(self) -> int:
        return len(PRESETS)


@pytest.fixture(scope="session")
def crowds() -> Crowds:
    """Twenty recordings of every preset, without provocations, at 60 Hz."""
    return Crowds()


def _act(preset: str, index: int) -> Performance:
    return perform(preset, seed=3, index=index, n_events=6, rate=60.0, provocations={})


@pytest.fixture(scope="session")
def adt_120() -> Performance:
    """One ADT recording at the full rate."""
    return perform("adt", seed=5, index=2, n_events=8, provocations={})
