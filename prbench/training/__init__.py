"""Training: public data loading, and the loop behind ``prbench train``. torch is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prbench.training.batches import LengthBatches
    from prbench.training.dataset import SequenceDataset
    from prbench.training.items import MotionBatch, MotionItem, collate
    from prbench.training.loop import fit
    from prbench.training.task import TrainingData, TrainingModule, TrainingTask

_HOMES = {
    "LengthBatches": "prbench.training.batches",
    "MotionBatch": "prbench.training.items",
    "MotionItem": "prbench.training.items",
    "SequenceDataset": "prbench.training.dataset",
    "TrainingData": "prbench.training.task",
    "TrainingModule": "prbench.training.task",
    "TrainingTask": "prbench.training.task",
    "collate": "prbench.training.items",
    "fit": "prbench.training.loop",
}

__all__ = [
    "LengthBatches",
    "MotionBatch",
    "MotionItem",
    "SequenceDataset",
    "TrainingData",
    "TrainingModule",
    "TrainingTask",
    "collate",
    "fit",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that the command line can list tasks without torch."""
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
