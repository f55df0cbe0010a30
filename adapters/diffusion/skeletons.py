"""Bodies of the batch on the skeleton that a model has learnt, and back.

Source: docs/specification/pr-model.md#data-and-features.

Models of P&R or Nymeria know bodies with their own bone lengths: nothing changes. Models of HumanML3D know one skeleton
only: conditions are put onto it, goals are scaled with the root, and the motion is scaled back.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from prbench.contract import ConditionBatch
from prbench.representation import UniformSkeleton


@runtime_checkable
class KnowsItsSkeleton(Protocol):
    """A model's configuration."""

    @property
    def uniform_skeleton(self) -> bool:
        """Whether the model has learnt bodies that were rescaled to HumanML3D's skeleton."""
        ...


@dataclass(frozen=True)
class ModelBodies:
    """A batch as a model sees it."""

    batch: ConditionBatch
    skeleton: UniformSkeleton | None
    """The change of skeleton; None if there is none."""

    @classmethod
    def of(cls, batch: ConditionBatch, configuration: KnowsItsSkeleton) -> ModelBodies:
        """The batch on the skeleton of the model.

        Without an initial pose (condition ``text``) the body is not known; then the motion keeps the model's size.
        """
        if not configuration.uniform_skeleton or batch.initial_joints is None:
            return cls(batch, None)
        skeleton = UniformSkeleton.of(batch.initial_joints)
        changed = {
            name: convert(getattr(batch, name))
            for name, convert in (
                ("initial_joints", skeleton.poses),
                ("previous_joints", skeleton.poses),
                ("goal_joints", skeleton.poses),
                ("goal_location", skeleton.locations),
            )
            if getattr(batch, name) is not None
        }
        return cls(dataclasses.replace(batch, **changed), skeleton)

    def own(self, joints: Float[np.ndarray, "batch frames 22 3"]) -> Float[np.ndarray, "batch frames 22 3"]:
        """What the model has generated, at the scale of the bodies, metres."""
        if self.skeleton is None:
            return joints
        return self.skeleton.own_scale(joints.reshape(len(joints), -1, 3)).reshape(joints.shape)
