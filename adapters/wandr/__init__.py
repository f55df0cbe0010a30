"""WANDR: a body that walks and reaches, frame by frame, by what its wrist, pelvis and heading intend.

docs/specification/wandr.md; its page is ``docs/methods/wandr.md``. This folder and one line among the entry points are
all there is of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from prbench_adapters.wandr.adapter import WANDR
    from prbench_adapters.wandr.training import WandrTask


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> WANDR:
    """Entry point ``wandr``: :func:`prbench_adapters.wandr.adapter.load`, imported when it is needed."""
    from prbench_adapters.wandr.adapter import load

    return load(weights, options=options, device=device)


def training_task() -> WandrTask:
    """Make the task that ``prbench train --method wandr`` trains."""
    from prbench_adapters.wandr.training import WandrTask

    return WandrTask()
