"""The method ``cvae``: a recurrent variational autoencoder of futures (docs/methods/cvae.md)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.prediction.adapter import LearnedPredictor
    from prbench_adapters.prediction.training import PredictorTask


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> LearnedPredictor:
    """Entry point ``cvae``: :func:`prbench_adapters.prediction.adapter.load_predictor`, imported when needed."""
    from prbench_adapters.prediction.adapter import load_predictor

    return load_predictor("cvae", weights, options=options, device=device)


def training_task() -> PredictorTask:
    """Make the task that ``prbench train --method cvae`` trains."""
    from prbench_adapters.prediction.training import PredictorTask, cvae

    return PredictorTask("cvae", cvae)
