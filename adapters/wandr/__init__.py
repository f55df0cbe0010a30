"""WANDR: a body that walks and reaches, frame by frame, by what its wrist, pelvis and heading intend.

docs/specification/wandr.md; its page is ``docs/methods/wandr.md``. This folder and one line among the entry points are
all there is of it. torch is imported on first use.
"""

from __future__ import annotations

from prbench_adapters.diffusion.method import late

load = late("wandr.adapter:load")
training_task = late("wandr.training:WandrTask")  # what `prbench train --method wandr` trains
