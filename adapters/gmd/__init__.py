"""GMD (Guided Motion Diffusion): everything of this method is in this folder. torch is imported on first use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.gmd.adapter import GMD
    from prbench_adapters.training.task import TrainingTask


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> GMD:
    """Entry point ``gmd``: :func:`prbench_adapters.gmd.adapter.load`."""
    from prbench_adapters.gmd import adapter

    return adapter.load(weights, options=options, device=device)


def training_task() -> TrainingTask:
    """Make the task that ``prbench train --method gmd`` trains."""
    from prbench_adapters.gmd.training import GMDTask

    return GMDTask()
