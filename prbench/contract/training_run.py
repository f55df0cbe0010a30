"""Where and how a method may train."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class TrainingRun:
    """Given to :meth:`prbench.contract.adapter.Trainable.fit`."""

    folder: Path
    """For checkpoints and logs; kept per table identity, so that a fit is done once."""
    seed: int
    device: str
