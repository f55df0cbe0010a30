"""DartControl: short primitives of a latent diffusion model, steered by their noise. torch is imported on first use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.dart.adapter import DartControl
    from prbench_adapters.dart.training import DartTask

__all__ = ["load", "training_task"]


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> DartControl:
    """Entry point ``dart`` (:func:`prbench_adapters.dart.adapter.load`)."""
    from prbench_adapters.dart.adapter import load as load_adapter

    return load_adapter(weights, options=options, device=device)


def training_task() -> DartTask:
    """Make the task that ``prbench train --method dart`` trains."""
    from prbench_adapters.dart.training import DartTask

    return DartTask()
