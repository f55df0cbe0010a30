"""DNO: the noise of a frozen text-to-motion model is optimised until its motion meets the keyframes.

The study's baseline (*Prime and Reach*, section 5.3; docs/specification/dno.md): no network of its own. With a prior
that was only pre-trained it is the study's zero-shot row; with one fine-tuned on P&R sequences, such as the bundled
``mdm-small``, the other one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench_adapters.diffusion.method import SingleModelMethod, bundled_names, require_goals_within_reach, resolve
from prbench_adapters.finishing import FINISHING_OPTIONS, Finishing

DEFAULT_WEIGHTS = "mdm-small"
_NO_PROMPT = "none"
_OWN_PROMPT = "own"
_MODES = ("fast", "paper")


class DNO(SingleModelMethod):
    """Meets the first frame and the goal by moving the noise; the initial velocity has no term unless asked for."""

    name = "dno"
    conditions = frozenset({Condition.GOAL_POSE, Condition.GOAL_LOCATION})

    def __init__(self, model: Any, weights: Path, settings: Any, *, prompt: str, finishing: Finishing) -> None:
        super().__init__(model, weights, settings, finishing=finishing)
        self.prompt = prompt

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Optimise one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or a sequence that is longer than the prior knows.
        """
        from prbench_adapters.diffusion.noise_optimisation import keyframes
        from prbench_adapters.diffusion.optimised_generation import generate_optimised

        require_goals_within_reach(batch, adapter=self.name)
        texts = batch.text
        if self.prompt != _OWN_PROMPT:
            texts = ("" if self.prompt == _NO_PROMPT else self.prompt,) * len(batch)
        motions = generate_optimised(self.model, batch, self.settings, objective=keyframes, texts=texts)
        return self.finishing(motions, batch)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> DNO:
    """Entry point ``dno``.

    Options: ``optimise`` (fast or paper), ``prompt`` (none, own for each sequence's text, or any text), ``guidance``
    (1), ``text-path``, ``feet`` (steps or predicted), and ``KEYFRAME_OPTIONS`` of
    :mod:`prbench_adapters.diffusion.noise_optimisation`.

    Args:
        weights: File, folder or name of bundled weights of a text-to-motion model; None for ``mdm-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, no such weights, or they need a goal.
        InputFileError: if the file is not one of a denoiser.
        ValueError: for options that are unknown or have impossible values.
    """
    from prbench_adapters.diffusion import noise_optimisation as noise
    from prbench_adapters.diffusion.generation import choice, number, require_known
    from prbench_adapters.diffusion.model import MotionModel, require_goal

    own = ("optimise", "prompt", "guidance", "text-path", *FINISHING_OPTIONS)
    require_known(options, (*own, *noise.KEYFRAME_OPTIONS))
    # The default belongs to another method, which a user may have removed.
    if weights is None and DEFAULT_WEIGHTS not in bundled_names():
        why = "(part of the method mdm) is not installed. Give --weights of a text-to-motion model."
        raise AdapterError(f"dno has no network of its own, and its default '{DEFAULT_WEIGHTS}' {why}")
    path = resolve(weights, DEFAULT_WEIGHTS)
    model = MotionModel.load(path, device, text_path=options.get("text-path"))
    require_goal(model, path, "none")
    steps = model.configuration.diffusion_steps
    preset = noise.dno_fast(steps) if choice(options, "optimise", _MODES) == "fast" else noise.dno_paper(steps)
    # The initial pose is given; bones of its lengths cost the goal nothing, where the prior's waver by a quarter.
    preset = replace(preset, bones="initial", guidance=number(options, "guidance", preset.guidance))
    settings = noise.optimisation_settings(options, preset, diffusion_steps=steps)
    return DNO(model, path, settings, prompt=options.get("prompt", _NO_PROMPT), finishing=Finishing.of(options))
