"""Correct motions of synthetic people, cut and put into their canonical frames; performed once."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.checking.doctor import Expected
from prbench.representation import canonicalise
from prbench.synthetic.people import PRESETS, perform

STRIDE, FRAMES = 3, 90  # 60 Hz to 20 frames a second; 4.5 s


@pytest.fixture(scope="session")
def crowds() -> dict[str, list[np.ndarray]]:
    """Motions of three people of every preset, float64."""
    return {preset: [part for index in range(3) for part in _acted(preset, index)] for preset in PRESETS}


@pytest.fixture(scope="session")
def everybody(crowds: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """The motions of all presets."""
    return [motion for motions in crowds.values() for motion in motions]


@pytest.fixture(scope="session")
def walkers(crowds: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """People who cross a room."""
    return [motion for motion in crowds["gimo"] if np.ptp(motion[:, 0, [0, 2]], axis=0).max() > 1.0]


def known(motion: np.ndarray) -> Expected:
    """What a table says of a motion, were it recorded."""
    return Expected(motion[0], 2 * motion[0] - motion[1], len(motion), 20.0)


def _acted(preset: str, index: int) -> list[np.ndarray]:
    joints = perform(preset, seed=3, index=index, n_events=3, rate=60.0, provocations={}).joints[::STRIDE]
    starts = range(20, len(joints) - FRAMES, FRAMES)
    return [canonicalise(joints[start : start + FRAMES]) for start in starts][:4]
