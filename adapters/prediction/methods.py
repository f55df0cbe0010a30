"""The methods of motion prediction that are learnt: gazemodiff, humanmac, cvae, dlow and belfusion.

Each is an entry point of its own, with a page in docs/methods/. torch is imported when one is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.prediction.adapter import LearnedPredictor
    from prbench_adapters.prediction.training import PredictorTask


def _load(name: str, weights: Path | None, *, options: Mapping[str, str], device: str) -> LearnedPredictor:
    """Load a predictor: :func:`prbench_adapters.prediction.adapter.load_predictor`, imported when needed."""
    from prbench_adapters.prediction.adapter import load_predictor

    return load_predictor(name, weights, options=options, device=device)


def _task(name: str) -> PredictorTask:
    """Make the task that ``prbench train --method NAME`` trains."""
    from prbench_adapters.prediction import training

    stages = training.STAGES_OF_BELFUSION if name == "belfusion" else (training.TRAIN,)
    return training.PredictorTask(name, stages)


load_belfusion = partial(_load, "belfusion")
load_cvae = partial(_load, "cvae")
load_dlow = partial(_load, "dlow")
load_gazemodiff = partial(_load, "gazemodiff")
load_humanmac = partial(_load, "humanmac")
train_belfusion = partial(_task, "belfusion")
train_cvae = partial(_task, "cvae")
train_dlow = partial(_task, "dlow")
train_gazemodiff = partial(_task, "gazemodiff")
train_humanmac = partial(_task, "humanmac")
