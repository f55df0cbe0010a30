"""How far a head follows its goal: slopes of where it points against where the goal is (docs/error-budget.md#gains)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Gain:
    """Least-squares line of an angle of the ray against the same angle of the goal."""

    slope: float
    """1 for a head that follows its goal, 0 for one that ignores it."""
    offset_deg: float
    """Angle of the ray for a goal straight ahead (angle 0), degrees."""
    correlation: float
    motions: int


def gain(goal_deg: Float[np.ndarray, " n"], ray_deg: Float[np.ndarray, " n"]) -> Gain | None:
    """Fit ``ray = offset + slope * goal``; entries that are not finite are left out.

    Args:
        goal_deg: Angle of the goal.
        ray_deg: Angle of the ray.

    Returns:
        None where fewer than three motions are left, or the goal has the same angle in all of them.
    """
    known = np.isfinite(goal_deg) & np.isfinite(ray_deg)
    goal = goal_deg[known]
    ray = ray_deg[known]
    if len(goal) < 3 or np.ptp(goal) < 1e-9:
        return None
    slope, offset = np.polyfit(goal, ray, 1)
    correlation = float(np.corrcoef(goal, ray)[0, 1]) if np.ptp(ray) > 0 else 0.0
    return Gain(float(slope), float(offset), correlation, len(goal))
