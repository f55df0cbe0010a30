"""The shared part of the methods that needs no torch: one model's weights, goals within reach, samples from text."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint

if TYPE_CHECKING:
    from prbench_adapters.diffusion.generation import SamplingSettings
    from prbench_adapters.diffusion.model import MotionModel

GOALS = {Condition.GOAL_LOCATION: "location", Condition.GOAL_POSE: "pose"}
"""Kind of goal of a model, by the condition of the protocol."""
_FARTHEST_GOAL = 10.0
_HIGHEST_GOAL = 3.0
"""Metres from the first pelvis, and from the floor: in twelve seconds nobody here comes farther or reaches higher."""
TEXT_GUIDANCE = 2.5
"""docs/specification/mdm.md#classifier-free-guidance; docs/specification/pr-model.md#sampling-without-optimisation."""
IN_TRAINING = Path("the network in training")
"""Stands in place of a weights file in the messages of a validation."""


def require_goals_within_reach(batch: ConditionBatch, *, adapter: str) -> None:
    """Refuse goals that are not finite or too far away to belong to this motion.

    Args:
        batch: With initial poses and goals.
        adapter: Who refuses, for the message.

    Raises:
        AdapterError: naming the row, its goal and the distance.
    """
    assert batch.initial_joints is not None
    goal = batch.goal_location if batch.goal_joints is None else batch.goal_joints[:, Joint.PELVIS]
    assert goal is not None
    distance = np.linalg.norm(goal - batch.initial_joints[:, Joint.PELVIS], axis=1)
    # All joints of a goal pose, not the pelvis alone: one NaN is enough to spoil the motion.
    finite = np.isfinite(goal if batch.goal_joints is None else batch.goal_joints.reshape(len(batch), -1)).all(axis=1)
    bad = np.flatnonzero(~finite | ~(distance <= _FARTHEST_GOAL) | (np.abs(goal[:, 1]) > _HIGHEST_GOAL))
    if bad.size:
        row = int(bad[0])
        where = ", ".join(f"{value:.2f}" for value in goal[row])
        raise AdapterError(
            f"adapter '{adapter}', row {row} of the batch (opaque id {batch.opaque_id[row][:12]}): expected a goal"
            f" within {_FARTHEST_GOAL:g} m of the first pose and {_HIGHEST_GOAL:g} m of the floor, found ({where}),"
            f" {distance[row]:.2f} m away. Goals are metres in the canonical frame of the first pose; `prbench view"
            " --data DIR` draws those of a table."
        )


class SingleModelMethod:
    """A method that generates with one model, whatever the condition.

    Args:
        model: The frozen model.
        weights: The file that it came from.
        settings: How it generates.
    """

    def __init__(self, model: Any, weights: Path, settings: Any) -> None:
        self.model, self.weights, self.settings = model, weights, settings
        self.max_frames: int | None = getattr(model.configuration, "max_frames", None)
        self.native_fps: float = model.configuration.fps

    def weights_for(self, condition: Condition) -> Path:  # noqa: ARG002 - one model for all
        """The weights file in use."""
        return self.weights


class TextSampler(SingleModelMethod):
    """Plain samples of a text-to-motion model: what MDM is, and what any pre-training on text is validated with.

    Every motion starts at the canonical origin and faces +Z.
    """

    name = "text-to-motion"
    conditions = frozenset({Condition.TEXT})

    model: MotionModel
    settings: SamplingSettings

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Sample one motion for each row."""
        from prbench_adapters.diffusion.generation import generate

        return generate(self.model, batch, self.settings)
