"""The result of a training; the command that reports it imports this without torch."""

from __future__ import annotations

from pathlib import Path

import msgspec


class TrainedNetwork(msgspec.Struct, frozen=True, kw_only=True):
    """A finished training.

    Attributes:
        weights: The trained weights.
        steps: Number of steps that the training has, those of interrupted runs with it.
        best_step: Step of the best validation, whose weights these are; None for the last ones.
    """

    weights: Path
    steps: int
    best_step: int | None = None
