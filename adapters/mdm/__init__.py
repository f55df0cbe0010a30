"""MDM (Motion Diffusion Model): everything of this method is in this folder. torch is imported on first use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.diffusion.tasks import DiffusionTask
    from prbench_adapters.mdm.adapter import MDM


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> MDM:
    """Entry point ``mdm``: :func:`prbench_adapters.mdm.adapter.load`."""
    from prbench_adapters.mdm import adapter

    return adapter.load(weights, options=options, device=device)


def training_task() -> DiffusionTask:
    """What ``prbench train --method mdm`` trains: text to motion, in pre-training and fine-tuning alike."""
    from prbench_adapters.diffusion.tasks import DiffusionTask
    from prbench_adapters.mdm.adapter import in_training

    return DiffusionTask("mdm", goals=(), configurations="prbench_adapters.mdm", validating=in_training)
