"""DartControl as a method of the benchmark (docs/specification/dart.md; *Prime and Reach*, section 5.3)."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from prbench.contract import Condition, ConditionBatch, Motions
from prbench_adapters.dart.generation import generate
from prbench_adapters.dart.model import DartModel
from prbench_adapters.dart.settings import OPTIONS, DartSettings, dart_settings
from prbench_adapters.diffusion.bundled import require_default, resolve
from prbench_adapters.diffusion.goals import require_goals_within_reach
from prbench_adapters.diffusion.options import require_known

NAME = "dart"
DEFAULT_WEIGHTS = "dart-small"


class DartControl:
    """Starts with the initial pose and velocity, and moves the noise of all primitives until the last frame fits."""

    name = NAME
    conditions = frozenset({Condition.GOAL_POSE, Condition.GOAL_LOCATION})

    def __init__(self, model: DartModel, weights: Path, settings: DartSettings) -> None:
        self.model, self.weights, self.settings = model, weights, settings
        self.native_fps = model.configuration.fps

    def weights_for(self, condition: Condition) -> Path:  # noqa: ARG002 - one model for both goals
        """The weights file in use."""
        return self.weights

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Generate one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or an initial state that has no heading.
        """
        require_goals_within_reach(batch, adapter=self.name)
        return generate(self.model, batch, self.settings)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> DartControl:
    """Entry point ``dart``.

    Options: ``optimise`` (on, or off for text alone), ``iterations`` (100), ``learning-rate`` (0.05), ``noise-scale``
    (0.1), ``ddim-steps`` (all of the training's), ``guidance`` (5), ``gradient-norm`` (sequence, or batch as the
    original), ``seeding`` (velocity or repeat), ``hand`` (right, nearest or left), ``jerk`` (0), ``floor`` (0),
    ``checkpointing`` (off or on), ``text-path`` (files of the text encoder, if the weights need one that has some).

    Args:
        weights: File, folder or name of bundled weights; None for ``dart-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or there are no such weights.
        InputFileError: if the file is not one of DART.
        ValueError: for options that are unknown or have impossible values.
    """
    require_known(options, OPTIONS)
    folder = Path(str(files("prbench_adapters.dart.weights")))
    if weights is None:
        require_default(NAME, DEFAULT_WEIGHTS, folder)
    path = resolve(weights, DEFAULT_WEIGHTS, folder=folder)
    model = DartModel.load(path, device, text_path=options.get("text-path"))
    return DartControl(model, path, dart_settings(options, diffusion_steps=model.configuration.diffusion_steps))
