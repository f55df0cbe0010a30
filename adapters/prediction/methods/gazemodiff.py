"""The method ``gazemodiff``: diffusion of windows under pose and gaze (docs/methods/gazemodiff.md)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.prediction.adapter import LearnedPredictor
    from prbench_adapters.prediction.training import PredictorTask


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> LearnedPredictor:
    """Entry point ``gazemodiff``: :func:`prbench_adapters.prediction.adapter.load_predictor`, imported when needed."""
    from prbench_adapters.prediction.adapter import load_predictor

    return load_predictor("gazemodiff", weights, options=options, device=device)


def training_task() -> PredictorTask:
    """Make the task that ``prbench train --method gazemodiff`` trains."""
    from prbench_adapters.prediction.training import PredictorTask, diffusion

    return PredictorTask("gazemodiff", diffusion)
