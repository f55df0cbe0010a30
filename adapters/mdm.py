"""MDM: text to motion by diffusion, blind to where the body stands and to any goal (``methods/mdm.md``).

The study's baseline of text alone (*Prime and Reach*, table 2), and the prior of the other diffusion methods.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from prbench.contract import Condition, ConditionBatch, Motions

if TYPE_CHECKING:
    from prbench_adapters.diffusion.generation import SamplingSettings
    from prbench_adapters.diffusion.model import MotionModel

DEFAULT_WEIGHTS = "mdm-small"
_GUIDANCE = 2.5  # methods/mdm.md, "Classifier-free guidance"


class MDM:
    """Samples motions from text; every motion starts at the canonical origin and faces +Z."""

    name = "mdm"
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


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> MDM:
    """Entry point ``mdm``.

    Options: ``guidance`` (2.5), ``sampler`` (ddpm or ddim), ``steps`` (all of the training's), ``precision`` (float32
    or bfloat16), ``text-path`` (files of the text encoder, if the weights need one that has some).

    Args:
        weights: File, folder or name of bundled weights; None for ``mdm-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, no such weights, or they need a goal.
        InputFileError: if the file is not one of a denoiser.
        ValueError: for options that are unknown or have impossible values.
    """
    from prbench_adapters.diffusion.bundled import resolve
    from prbench_adapters.diffusion.model import MotionModel, require_goal
    from prbench_adapters.diffusion.options import SAMPLING_OPTIONS, require_known, sampling_settings

    require_known(options, (*SAMPLING_OPTIONS, "text-path"))
    path = resolve(weights, DEFAULT_WEIGHTS)
    model = MotionModel.load(path, device, text_path=options.get("text-path"))
    require_goal(model, path, "none")
    steps = model.configuration.diffusion_steps
    return MDM(model, path, sampling_settings(options, guidance=_GUIDANCE, diffusion_steps=steps))
