"""Moves fill fixations that would prime a goal before its time.

Source: docs/specification/synthetic-recordings.md#eye-head-trunk, point 6 of the schedule.

What remains after three rounds, looks at neighbouring goals above all, is a real prime, and the truth says so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from prbench.rays import near_miss
from prbench.synthetic.people.gaze_plan import WINDOW, GazePlan, Look
from prbench.synthetic.people.geometry import direction, yaw_and_pitch
from prbench.synthetic.people.plan import Plan

_MARGIN, _MARGIN_PER_METRE = 0.05, 0.03
_SHIFT = (np.deg2rad(11.0), np.deg2rad(29.0))


def repaired(
    plan: Plan,
    gaze_plan: GazePlan,
    eye: Float[np.ndarray, "n 3"],
    gaze: Float[np.ndarray, "n 3"],
    times: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> GazePlan:
    """One round of repair; returns the plan itself when nothing offends.

    Args:
        plan: Goals and event times.
        gaze_plan: Looks to repair.
        eye: True eye positions.
        gaze: True gaze directions that follow from the plan.
        times: Frame times, seconds.
        rng: For the size of the shifts.
    """
    offending = sorted(_offending_looks(plan, gaze_plan, eye, gaze, times))
    if not offending:
        return gaze_plan
    looks = list(gaze_plan.looks)
    for number in offending:
        look = looks[number]
        index = min(int(np.searchsorted(times, look.start)), times.size - 1)
        looks[number] = _moved(look, eye[index], rng)
    return replace(gaze_plan, looks=tuple(looks))


def _offending_looks(plan: Plan, gaze_plan: GazePlan, eye: np.ndarray, gaze: np.ndarray, times: np.ndarray) -> set[int]:
    starts = np.array([look.start for look in gaze_plan.looks])
    found: set[int] = set()
    for reach, prime, kind in zip(plan.reaches, gaze_plan.primes, gaze_plan.kinds, strict=True):
        if kind == "unseen":
            continue
        until = reach.event if prime is None or kind == "swept" else prime
        first, last = np.searchsorted(times, [reach.event - WINDOW, until])
        low, high = reach.centre - reach.half_world, reach.centre + reach.half_world
        passed = near_miss(eye[first:last], gaze[first:last], low[None], high[None])
        along = passed.along[:, 0]
        close = (passed.distance[:, 0] <= _MARGIN + _MARGIN_PER_METRE * along) & (along >= 0.0)
        frames = times[first:last][close]
        numbers = np.unique(np.searchsorted(starts, frames, side="right") - 1)
        found.update(
            int(number)
            for number in numbers
            if not gaze_plan.looks[number].is_goal and gaze_plan.looks[number].reach is None
        )
    return found


def _moved(look: Look, eye: np.ndarray, rng: np.random.Generator) -> Look:
    """Up, or down when already high, and to one side."""
    sight = look.point - eye
    yaw, pitch = yaw_and_pitch(sight)
    upward, sideways = rng.uniform(*_SHIFT, 2)
    pitch = pitch - upward if pitch - upward > np.deg2rad(-40.0) else pitch + upward
    yaw = yaw + (sideways if rng.random() < 0.5 else -sideways)
    return replace(look, point=eye + np.linalg.norm(sight) * direction(yaw, pitch))
