"""Batches of conditions with a goal, for tests of the methods that reach one."""

from __future__ import annotations

import numpy as np

from prbench.contract import Condition, ConditionBatch
from tests.fakes import STANDING


def conditions(condition: Condition, n: int = 3, *, frames: tuple[int, ...] = (24, 17, 30)) -> ConditionBatch:
    """People who stand at the origin, with goals around them; rows differ in length, goal and seed."""
    generator = np.random.default_rng(5)
    standing = np.broadcast_to(STANDING.astype(np.float32), (n, 22, 3)).copy()
    offsets = generator.uniform(-1.0, 1.0, size=(n, 3)).astype(np.float32)
    goals = {
        Condition.GOAL_LOCATION: {"goal_location": offsets + np.float32([0.0, 1.0, 0.5])},
        Condition.GOAL_POSE: {"goal_joints": standing + offsets[:, None]},
    }
    return ConditionBatch(
        condition=condition,
        n_frames=np.array([frames[row % len(frames)] for row in range(n)]),
        fps=20.0,
        opaque_id=tuple(f"{row:064d}" for row in range(n)),
        noise_seed=tuple(1000 + row for row in range(n)),
        text=tuple(("The person moves across and picks an object.",) * n),
        initial_joints=standing,
        previous_joints=standing - np.float32(0.01),
        **goals[condition],
    )
