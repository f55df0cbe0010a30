"""Training: public data loading, and the loop behind ``prbench train``. torch is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prbench_adapters.training.batches import LengthBatches
    from prbench_adapters.training.dataset import MotionBatch, MotionItem, SequenceDataset, collate
    from prbench_adapters.training.loop import fit
    from prbench_adapters.training.task import TrainingData, TrainingModule, TrainingTask

_HOMES = {
    "LengthBatches": "prbench_adapters.training.batches",
    "MotionBatch": "prbench_adapters.training.dataset",
    "MotionItem": "prbench_adapters.training.dataset",
    "SequenceDataset": "prbench_adapters.training.dataset",
    "TrainingData": "prbench_adapters.training.task",
    "TrainingModule": "prbench_adapters.training.task",
    "TrainingTask": "prbench_adapters.training.task",
    "collate": "prbench_adapters.training.dataset",
    "fit": "prbench_adapters.training.loop",
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
