"""Plain samples of a text-to-motion model: what MDM is, and what any pre-training on text is validated with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from prbench.contract import Condition, ConditionBatch, Motions

if TYPE_CHECKING:
    from prbench_adapters.diffusion.generation import SamplingSettings
    from prbench_adapters.diffusion.model import MotionModel

TEXT_GUIDANCE = 2.5
"""docs/specification/mdm.md#classifier-free-guidance; docs/specification/pr-model.md#sampling-without-optimisation."""
IN_TRAINING = Path("the network in training")
"""In place of a weights file, for messages of a validation."""


class TextSampler:
    """Samples motions from text; every motion starts at the canonical origin and faces +Z."""

    name = "text-to-motion"
    conditions = frozenset({Condition.TEXT})

    def __init__(self, model: MotionModel, weights: Path, settings: SamplingSettings) -> None:
        self.model, self.weights, self.settings = model, weights, settings
        self.max_frames = model.configuration.max_frames
        self.native_fps = model.configuration.fps

    def weights_for(self, condition: Condition) -> Path:  # noqa: ARG002 - one model
        """The weights file in use."""
        return self.weights

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Sample one motion for each row."""
        from prbench_adapters.diffusion.generation import generate

        return generate(self.model, batch, self.settings)
