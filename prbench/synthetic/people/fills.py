"""Looks that are not at a goal: along the path, at the own hands, around the room, at other goals.

Source: docs/specification/synthetic-recordings.md#eye-head-trunk, points 5 and 6 of the schedule.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePath
from prbench.synthetic.people.kinematics import direction, wrap
from prbench.synthetic.people.plan import Plan

_LONGEST_FILL = 1.6  # s
_SHORTEST_FILL = 0.15
_WALKING = 0.3  # metres per second
_BEARING_AT_START = np.deg2rad(69.0)
_BEARING_AT_END = np.deg2rad(86.0)
_SMALL_SHIFT = np.deg2rad(28.0)
_TRIES = 14


@dataclass(frozen=True)
class Avoidance:
    """A goal that no fill may look at during some time, lest it prime the event."""

    point: Float[np.ndarray, "3"]
    start: float
    end: float


class FillDrawer:
    """Draws fill fixations one after the other."""

    def __init__(
        self,
        plan: Plan,
        base: BasePath,
        eye: np.ndarray,
        times: np.ndarray,
        avoid: list[Avoidance],
        rng: np.random.Generator,
    ) -> None:
        self.plan = plan
        self.base = base
        self.eye = eye
        self.times = times
        self.rng = rng
        self.points = np.array([item.point for item in avoid]).reshape(-1, 3)
        self.spans = np.array([(item.start, item.end) for item in avoid]).reshape(-1, 2)

    def draw(self, now: float, until: float, previous: np.ndarray | None) -> tuple[float, np.ndarray]:
        """Draw duration and point of the fill that begins ``now`` and ends by ``until``."""
        index = min(int(np.searchsorted(self.times, now)), self.times.size - 1)
        walking = bool(self.base.speed[index] > _WALKING)
        duration = 0.38 * np.exp(0.55 * self.rng.standard_normal())
        duration = float(np.clip(duration, _SHORTEST_FILL, 0.6 if walking else _LONGEST_FILL))
        if until - now - duration < _SHORTEST_FILL:
            duration = until - now
        avoided = self._avoided(now, now + duration)
        last = min(int(np.searchsorted(self.times, now + duration)), self.times.size - 1)
        point = self._ahead(index)
        for attempt in range(_TRIES):
            near = duration < 0.35 and attempt < _TRIES // 2
            point = self._candidate(index, walking, previous if near else None)
            if self._is_seen(point, index, last) and self._misses(point, index, avoided):
                return duration, point
        return duration, self._evade(point, index, avoided)

    def _avoided(self, start: float, end: float) -> np.ndarray:
        """Return the goals that would be primed by a look in this interval."""
        return self.points[(self.spans[:, 0] <= end + 0.1) & (self.spans[:, 1] >= start)]

    def _candidate(self, index: int, walking: bool, previous: np.ndarray | None) -> np.ndarray:
        rng = self.rng
        eye = self.eye[index]
        if previous is not None:
            point = self._near_direction(eye, previous)
        elif walking and rng.random() < 0.5:
            point = self._ahead(index)
        elif rng.random() < self.plan.preset.work_looks:
            point = self._work_area(index)
        elif rng.random() < 0.5 and self.plan.reaches:
            goal = self.plan.reaches[int(rng.integers(len(self.plan.reaches)))]
            point = goal.centre + 0.3 * goal.half_world * rng.standard_normal(3)
        else:
            point = self._around(index)
        return self._pushed_away(eye, point) if walking else point

    def _near_direction(self, eye: np.ndarray, previous: np.ndarray) -> np.ndarray:
        sight = previous - eye
        distance = float(np.linalg.norm(sight))
        yaw = np.arctan2(sight[0], sight[2]) + self.rng.uniform(-1.0, 1.0) * _SMALL_SHIFT * 0.8
        pitch = -np.arcsin(sight[1] / distance) + self.rng.uniform(-1.0, 1.0) * _SMALL_SHIFT * 0.4
        return eye + distance * direction(yaw, np.clip(pitch, -0.5, 1.2))

    def _ahead(self, index: int) -> np.ndarray:
        """Return a point along the path as it will be in 1.2 s."""
        soon = min(index + int(1.2 / (self.times[1] - self.times[0])), self.times.size - 1)
        heading = self.base.heading[soon]
        point = self.base.points[soon] + self.rng.uniform(1.2, 3.0) * direction(heading, 0.0)
        point[1] = self.eye[index, 1] - self.rng.uniform(0.1, 0.9)
        return point

    def _work_area(self, index: int) -> np.ndarray:
        heading = self.base.heading[index] + self.rng.uniform(-0.5, 0.5)
        point = self.eye[index] + self.rng.uniform(0.25, 0.55) * direction(heading, 0.0)
        point[1] = self.eye[index, 1] - self.rng.uniform(0.38, 0.62)
        return point

    def _around(self, index: int) -> np.ndarray:
        heading = self.base.heading[index] + self.rng.uniform(-1.0, 1.0) * _BEARING_AT_START
        distance = self.rng.uniform(0.6, 2.5)
        point = self.eye[index] + distance * direction(heading, 0.0)
        point[1] = max(0.05, self.eye[index, 1] - self.rng.uniform(-0.2, 0.75) * min(distance, 1.2))
        return point

    def _pushed_away(self, eye: np.ndarray, point: np.ndarray) -> np.ndarray:
        distance = float(np.linalg.norm(point - eye))
        if distance >= 1.0:
            return point
        return eye + (point - eye) * (self.rng.uniform(2.0, 4.0) / distance)

    def _is_seen(self, point: np.ndarray, first: int, last: int) -> bool:
        return bool(self._bearing(point, first) <= _BEARING_AT_START and self._bearing(point, last) <= _BEARING_AT_END)

    def _bearing(self, point: np.ndarray, index: int) -> float:
        bearing = np.arctan2(point[0] - self.eye[index, 0], point[2] - self.eye[index, 2])
        return abs(float(wrap(bearing - self.base.heading[index])))

    def _misses(self, point: np.ndarray, index: int, avoided: np.ndarray) -> bool:
        if not len(avoided):
            return True
        sight = point - self.eye[index]
        goals = avoided - self.eye[index]
        distance = np.linalg.norm(goals, axis=1)
        cosine = goals @ sight / (distance * np.linalg.norm(sight))
        return bool(np.all(np.arccos(np.clip(cosine, -1.0, 1.0)) > np.arctan(0.16 / distance) + np.deg2rad(3.0)))

    def _evade(self, point: np.ndarray, index: int, avoided: np.ndarray) -> np.ndarray:
        """Return some direction within sight that misses every avoided goal, the nearest found to straight ahead."""
        for sideways in (0.0, 0.35, -0.35, 0.7, -0.7, 1.0, -1.0):
            for pitch in (0.1, -0.25, 0.5, 0.8):
                ahead = self.eye[index] + 1.5 * direction(self.base.heading[index] + sideways, pitch)
                if self._misses(ahead, index, avoided):
                    return ahead
        return point
