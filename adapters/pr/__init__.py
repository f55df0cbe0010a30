"""P&R (Prime and Reach), the study's own method: all of it is in this folder. torch is imported on first use."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.diffusion.tasks import DiffusionTask
    from prbench_adapters.pr.adapter import PR


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> PR:
    """Entry point ``pr``: :func:`prbench_adapters.pr.adapter.load`."""
    from prbench_adapters.pr import adapter

    return adapter.load(weights, options=options, device=device)


def training_task() -> DiffusionTask:
    """What ``prbench train --method pr`` trains: text, initial state and goal; its pre-training may be ``mdm``'s."""
    from prbench_adapters.diffusion.tasks import DiffusionTask
    from prbench_adapters.pr.adapter import in_training

    return DiffusionTask("pr", goals=("pose", "location"), configurations="prbench_adapters.pr", validating=in_training)
