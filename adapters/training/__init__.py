"""Training: public data loading, and the loop behind ``prbench train``. torch is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prbench_adapters.training.batches import LengthBatches
    from prbench_adapters.training.dataset import MotionBatch, MotionItem, SequenceDataset, collate
    from prbench_adapters.training.loop import fit
    from prbench_adapters.training.task import TrainingData, TrainingModule, TrainingTask

_HOMES: dict[str, str] = dict.fromkeys(("MotionBatch", "MotionItem", "SequenceDataset", "collate"), "dataset")
_HOMES |= dict.fromkeys(("TrainingData", "TrainingModule", "TrainingTask"), "task")
_HOMES |= {"LengthBatches": "batches", "fit": "loop"}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that the command line can list tasks without torch."""
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
