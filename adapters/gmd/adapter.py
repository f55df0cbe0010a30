"""GMD: guided motion diffusion, a trajectory of the root towards keyframes and then a body that follows it.

One of the study's compared methods (*Prime and Reach*, table 2; docs/specification/gmd.md). Goals enter at sampling
alone, by gradients through the networks and by imputation; the networks know text only.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, cast

from prbench.contract import Condition, ConditionBatch, Motions
from prbench_adapters.diffusion.goals import require_goals_within_reach

if TYPE_CHECKING:
    from prbench_adapters.gmd.goals import Keyframes
    from prbench_adapters.gmd.model import GMDModel
    from prbench_adapters.gmd.sampling import GoalLoss
    from prbench_adapters.gmd.stages import GMDSettings, Imputation

NAME = "gmd"
DEFAULT_WEIGHTS = "gmd-small"
_OPTIONS = ("guidance", "goal-scale", "goal-loss", "imputation", "keyframes", "steps", "clamp", "bones", "text-path")


class GMD:
    """Brings the pelvis to where the goal pose has it, or with ``keyframes="pose"`` the whole body."""

    name = NAME
    conditions = frozenset({Condition.GOAL_POSE})

    def __init__(self, model: GMDModel, weights: Path, settings: GMDSettings) -> None:
        self.model, self.weights, self.settings = model, weights, settings
        self.max_frames = model.configuration.max_frames
        self.native_fps = model.configuration.fps

    def weights_for(self, condition: Condition) -> Path:  # noqa: ARG002 - one model
        """The weights file in use."""
        return self.weights

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Sample one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or a sequence that is longer than the model knows.
        """
        from prbench_adapters.gmd.generation import generate

        require_goals_within_reach(batch, adapter=self.name)
        return generate(self.model, batch, self.settings)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> GMD:
    """Entry point ``gmd``.

    Options: ``keyframes`` (root, or pose to impute both given poses), ``guidance`` (2.5), ``goal-scale`` (100, weight
    of the goal's gradient), ``goal-loss`` (absolute or squared), ``imputation`` (end, demo or evaluation: until when is
    imputed), ``steps`` (of each stage; all of the training's), ``clamp`` (6 standard deviations, at which
    estimates of the trajectory are cut), ``bones`` (predicted, or initial for the lengths of the initial pose),
    ``text-path`` (files of the text encoder, if the weights need one that has some).

    Args:
        weights: File, folder or name of bundled weights; None for ``gmd-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or there are no such weights.
        InputFileError: if the file is not one of GMD.
        ValueError: for options that are unknown or have impossible values.
    """
    from prbench_adapters.diffusion.bundled import require_default, resolve
    from prbench_adapters.diffusion.options import require_known
    from prbench_adapters.gmd.model import GMDModel

    require_known(options, _OPTIONS)
    folder = weights_folder()
    if weights is None:
        require_default(NAME, DEFAULT_WEIGHTS, folder)
    path = resolve(weights, DEFAULT_WEIGHTS, folder=folder)
    model = GMDModel.load(path, device, text_path=options.get("text-path"))
    return GMD(model, path, _settings(options, diffusion_steps=model.configuration.diffusion_steps))


def weights_folder() -> Path:
    """Where this method's bundled weights are."""
    return Path(str(files("prbench_adapters.gmd.weights")))


def _settings(options: Mapping[str, str], *, diffusion_steps: int) -> GMDSettings:
    from prbench_adapters.diffusion.options import choice, number, whole_number
    from prbench_adapters.gmd.stages import GMDSettings

    return GMDSettings(
        guidance=number(options, "guidance", GMDSettings.guidance),
        goal_scale=number(options, "goal-scale", GMDSettings.goal_scale),
        goal_loss=cast("GoalLoss", choice(options, "goal-loss", ("absolute", "squared"))),
        imputation=cast("Imputation", choice(options, "imputation", ("end", "demo", "evaluation"))),
        keyframes=cast("Keyframes", choice(options, "keyframes", ("root", "pose"))),
        steps=whole_number(options, "steps", most=diffusion_steps),
        clamp=number(options, "clamp", GMDSettings.clamp, least=1.0),
        bones="initial" if choice(options, "bones", ("predicted", "initial")) == "initial" else "predicted",
    )
