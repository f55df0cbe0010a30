"""DartControl: short primitives of a latent diffusion model, steered by their noise. torch is imported on first use."""

from __future__ import annotations

from prbench_adapters.diffusion.method import late

load = late("dart.adapter:load")
training_task = late("dart.training:DartTask")  # what `prbench train --method dart` trains
