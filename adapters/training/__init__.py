"""Training: public data loading, and the loop behind ``prbench train``. torch is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prbench_adapters.training.batches import LengthBatches
    from prbench_adapters.training.dataset import MotionBatch, MotionItem, SequenceDataset, collate
    from prbench_adapters.training.loop import fit
    from prbench_adapters.training.task import TrainingData, TrainingModule, TrainingTask

_HOMES = {
    "batches": ("LengthBatches",),
    "dataset": ("MotionBatch", "MotionItem", "SequenceDataset", "collate"),
    "loop": ("fit",),
    "task": ("TrainingData", "TrainingModule", "TrainingTask"),
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that the command line can list tasks without torch."""
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(f"{__name__}.{home}"), name)
