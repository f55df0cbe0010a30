"""The method ``dlow``: futures that are designed together, over a trained CVAE (docs/methods/dlow.md)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.prediction.adapter import LearnedPredictor
    from prbench_adapters.prediction.training import PredictorTask


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> LearnedPredictor:
    """Entry point ``dlow``: :func:`prbench_adapters.prediction.adapter.load_predictor`, imported when needed."""
    from prbench_adapters.prediction.adapter import load_predictor

    return load_predictor("dlow", weights, options=options, device=device)


def training_task() -> PredictorTask:
    """Make the task that ``prbench train --method dlow`` trains."""
    from prbench_adapters.prediction.training import PredictorTask, dlow

    return PredictorTask("dlow", dlow)
