"""The result of a training; the command that reports it imports this without torch."""

from __future__ import annotations

from pathlib import Path

import msgspec


class TrainedNetwork(msgspec.Struct, frozen=True, kw_only=True):
    """A finished training.

    Attributes:
        weights: The trained weights.
        steps: Number of steps that the training has, those of interrupted runs with it.
    """

    weights: Path
    steps: int
