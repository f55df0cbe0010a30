"""GMD (Guided Motion Diffusion): everything of this method is in this folder. torch is imported on first use."""

from __future__ import annotations

from prbench_adapters.diffusion.method import late

load = late("gmd.adapter:load")
training_task = late("gmd.training:GMDTask")  # what `prbench train --method gmd` trains
