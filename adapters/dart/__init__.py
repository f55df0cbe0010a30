"""DartControl: short primitives of a latent diffusion model, steered by their noise. torch is imported on first use."""

from __future__ import annotations

from prbench_adapters.diffusion.method import late

load = late("dart.adapter:load")


def training_task() -> object:
    """Make the task that ``prbench train --method dart`` trains."""
    return late("dart.training:DartTask")()
