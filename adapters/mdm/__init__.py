"""MDM: text to motion by diffusion, blind to where the body stands and to any goal (docs/specification/mdm.md).

The study's baseline of text alone (*Prime and Reach*, table 2), and the prior of the other diffusion methods. torch is
imported on first use.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from prbench.contract import Condition, ConditionBatch, Motions
from prbench_adapters.diffusion.method import TEXT_GUIDANCE, SingleModelMethod, late, resolve
from prbench_adapters.finishing import FINISHING_OPTIONS, Finishing

DEFAULT_WEIGHTS = "mdm-small"


class MDM(SingleModelMethod):
    """Samples motions from text; every motion starts at the canonical origin and faces +Z."""

    name = "mdm"
    conditions = frozenset({Condition.TEXT})

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Sample one motion for each row."""
        from prbench_adapters.diffusion.generation import generate

        return self.finishing(generate(self.model, batch, self.settings), batch)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> MDM:
    """Entry point ``mdm``.

    Options: ``guidance`` (2.5), ``sampler`` (ddpm or ddim), ``steps`` (all of the training's), ``text-path``
    (files of the text encoder, if the weights need one that has some), and ``FINISHING_OPTIONS``.

    Args:
        weights: File, folder or name of bundled weights; None for ``mdm-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, no such weights, or they need a goal.
        InputFileError: if the file is not one of a denoiser.
        ValueError: for options that are unknown or have impossible values.
    """
    from prbench_adapters.diffusion.generation import SAMPLING_OPTIONS, require_known, sampling_settings
    from prbench_adapters.diffusion.model import MotionModel, require_goal

    require_known(options, (*SAMPLING_OPTIONS, *FINISHING_OPTIONS, "text-path"))
    path = resolve(weights, DEFAULT_WEIGHTS)
    model = MotionModel.load(path, device, text_path=options.get("text-path"))
    require_goal(model, path, "none")
    steps = model.configuration.diffusion_steps
    settings = sampling_settings(options, guidance=TEXT_GUIDANCE, diffusion_steps=steps)
    return MDM(model, path, settings, finishing=Finishing.of(options))


def training_task() -> object:
    """Make the task of ``prbench train --method mdm``: text to motion, in pre-training and fine-tuning alike."""
    return late("diffusion.training:DiffusionTask")("mdm", goals=(), configurations="prbench_adapters.mdm")
