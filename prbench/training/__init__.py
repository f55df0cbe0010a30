"""Training: public data loading, and the loop behind ``prbench train``. torch is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from prbench.training.batch import MotionBatch, collate
    from prbench.training.dataset import MotionItem, SequenceDataset
    from prbench.training.sampling import LengthBatches

_HOMES = {
    "LengthBatches": "prbench.training.sampling",
    "MotionBatch": "prbench.training.batch",
    "MotionItem": "prbench.training.dataset",
    "SequenceDataset": "prbench.training.dataset",
    "collate": "prbench.training.batch",
}

__all__ = ["LengthBatches", "MotionBatch", "MotionItem", "SequenceDataset", "collate"]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that the command line can list tasks without torch."""
    if name not in _HOMES:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(_HOMES[name]), name)
