"""Moves fill fixations that would prime a goal before its time.

Source: docs/specification/synthetic-recordings.md#eye-head-trunk, point 6 of the schedule.

What remains after three rounds, looks at neighbouring goals above all, is a real prime, and the truth says so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

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
        close = _passes_close(eye[first:last], gaze[first:last], reach.centre, reach.half_world)
        frames = times[first:last][close]
        numbers = np.unique(np.searchsorted(starts, frames, side="right") - 1)
        found.update(
            int(number)
            for number in numbers
            if not gaze_plan.looks[number].is_goal and gaze_plan.looks[number].reach is None
        )
    return found


def _passes_close(eye: np.ndarray, gaze: np.ndarray, centre: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Return (n,) True where a ray passes a box in front of the eye, closer than its margin."""
    offset = centre - eye
    along = np.einsum("nk,nk->n", offset, gaze)
    across = offset - along[:, None] * gaze
    with np.errstate(divide="ignore"):  # the ray through the centre is at no share of the way
        border = (half / np.abs(across)).min(axis=1)  # share of the way from the centre to the ray where the box ends
    distance = np.linalg.norm(across, axis=1) * np.maximum(1.0 - border, 0.0)
    return (distance <= _MARGIN + _MARGIN_PER_METRE * along) & (along >= 0.0)


def _moved(look: Look, eye: np.ndarray, rng: np.random.Generator) -> Look:
    """Up, or down when already high, and to one side."""
    sight = look.point - eye
    yaw, pitch = yaw_and_pitch(sight)
    upward, sideways = rng.uniform(*_SHIFT, 2)
    pitch = pitch - upward if pitch - upward > np.deg2rad(-40.0) else pitch + upward
    yaw = yaw + (sideways if rng.random() < 0.5 else -sideways)
    return replace(look, point=eye + np.linalg.norm(sight) * direction(yaw, pitch))
