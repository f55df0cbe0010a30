"""Which goal of the protocol a model knows by which name, and which goals no body can reach."""

from __future__ import annotations

import numpy as np

from prbench.contract import Condition, ConditionBatch
from prbench.errors import AdapterError
from prbench.skeleton import Joint

GOALS = {Condition.GOAL_LOCATION: "location", Condition.GOAL_POSE: "pose"}
"""Kind of goal of a model, by the condition of the protocol."""
FARTHEST_GOAL, HIGHEST_GOAL = 10.0, 3.0
"""Metres from the first pelvis, and from the floor: in twelve seconds nobody here comes farther or reaches higher."""


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
    finite = np.isfinite(goal if batch.goal_joints is None else batch.goal_joints.reshape(len(batch), -1)).all(axis=1)
    bad = np.flatnonzero(~finite | ~(distance <= FARTHEST_GOAL) | (np.abs(goal[:, 1]) > HIGHEST_GOAL))
    if bad.size:
        row = int(bad[0])
        where = ", ".join(f"{value:.2f}" for value in goal[row])
        raise AdapterError(
            f"adapter '{adapter}', row {row} of the batch (opaque id {batch.opaque_id[row][:12]}): expected a goal"
            f" within {FARTHEST_GOAL:g} m of the first pose and {HIGHEST_GOAL:g} m of the floor, found ({where}),"
            f" {distance[row]:.2f} m away. Goals are"
            " metres in the canonical frame of the first pose; `prbench validate` checks a table."
        )
