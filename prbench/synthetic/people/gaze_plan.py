"""Looks that are not at a goal: along the path, at the own hands, around the room, at other goals.

Source: docs/specification/synthetic-recordings.md#eye-head-trunk, points 5 and 6 of the schedule.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.kinematics import direction, wrap, yaw_and_pitch
from prbench.synthetic.people.person import Preset
from prbench.synthetic.people.plan import Plan, Reach
from prbench.synthetic.people.walking import BasePath

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


_SHORTEST_LOOK = 0.15  # s
WINDOW = 10.0
"""Seconds before an event in which a look can prime."""
_GAP_LIMITS = (0.35, 9.7)  # s from the first look to the event; inside the window of ten seconds with a margin
_SEEN_BEFORE_TOUCHED = 0.7
_WIDEST_BEARING = np.deg2rad(86.0)  # from the heading; what lies further back cannot be looked at
_SWEEP = np.deg2rad(13.0)  # on either side of the goal


@dataclass(frozen=True)
class Look:
    """One fixation of the plan."""

    start: float
    end: float
    point: Float[np.ndarray, "3"]
    is_goal: bool
    reach: int | None


@dataclass(frozen=True)
class GazePlan:
    """Fixations in order of time without gaps, and the planned prime of every reach (None: not primed)."""

    looks: tuple[Look, ...]
    primes: tuple[float | None, ...]
    kinds: tuple[str, ...]
    """``plain``, ``near``, ``unprimed``, ``swept`` or ``unseen`` (no rule either way) for every reach."""


class _Timeline:
    """Looks that never overlap; who comes first keeps the time."""

    def __init__(self) -> None:
        self.looks: list[Look] = []

    def free_parts(self, start: float, end: float) -> list[tuple[float, float]]:
        """Return what is left of an interval."""
        parts = [(start, end)]
        for look in self.looks:
            parts = [
                piece
                for begin, stop in parts
                for piece in ((begin, min(stop, look.start)), (max(begin, look.end), stop))
                if piece[1] - piece[0] > 1e-9
            ]
        return parts

    def add(self, look: Look) -> None:
        """Add the parts of a look whose time is free and long enough."""
        for begin, stop in self.free_parts(look.start, look.end):
            if stop - begin >= _SHORTEST_LOOK:
                self.looks.append(Look(begin, stop, look.point, look.is_goal, look.reach))


def plan_gaze(
    plan: Plan,
    base: BasePath,
    eye: Float[np.ndarray, "n 3"],
    times: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> GazePlan:
    """Schedule all looks of a recording.

    Args:
        plan: Events and their times.
        base: Base pose at every frame.
        eye: About where the eyes will be.
        times: Frame times, seconds.
        rng: The recording's gaze generator.
    """
    scheduler = _Scheduler(plan, base, eye, times, rng)
    timeline = _Timeline()
    kinds = tuple(scheduler.kind(reach) for reach in plan.reaches)
    primes = tuple(
        None if kind in ("unprimed", "unseen") else scheduler.prime_time(reach)
        for reach, kind in zip(plan.reaches, kinds, strict=True)
    )
    asked = [
        scheduler.sweep(reach, prime) if kind == "swept" else scheduler.goal_looks(reach, prime, kind)
        for reach, prime, kind in zip(plan.reaches, primes, kinds, strict=True)
        if prime is not None
    ]
    # All first looks claim their time before any guiding look does, and those before returns.
    for priority in range(3):
        for parts in asked:
            for look in parts[priority]:
                timeline.add(look)
    goals = sorted(timeline.looks, key=lambda look: look.start)
    avoid = [
        Avoidance(reach.centre, reach.event - WINDOW, reach.event if prime is None or kind == "swept" else prime)
        for reach, prime, kind in zip(plan.reaches, primes, kinds, strict=True)
        if kind != "unseen"
    ]
    drawer = FillDrawer(plan, base, eye, times, avoid, rng)
    end = float(times[-1])
    looks: list[Look] = []
    now = 0.0
    last = Look(end, end, np.zeros(3), False, None)
    for goal in (*goals, last):
        while goal.start - now > 1e-9:
            duration, point = drawer.draw(now, goal.start, looks[-1].point if looks else None)
            looks.append(Look(now, now + duration, point, False, None))
            now += duration
        if goal is not last:
            looks.append(goal)
            now = goal.end
    return GazePlan(tuple(looks), primes, kinds)


class _Scheduler:
    """The draws of docs/specification/synthetic-recordings.md#eye-head-trunk for single events."""

    def __init__(
        self, plan: Plan, base: BasePath, eye: np.ndarray, times: np.ndarray, rng: np.random.Generator
    ) -> None:
        self.plan = plan
        self.base = base
        self.eye = eye
        self.times = times
        self.rng = rng

    def kind(self, reach: Reach) -> str:
        """Draw whether the goal is looked at, looked past, or not looked at; provocations are always looked at."""
        preset = self.plan.preset
        chance = self.rng.random()
        if reach.action == "hover":
            return "unseen"
        if reach.tag != "plain":
            return "swept" if reach.tag == "swept" else "plain"
        if chance < preset.unprimed:
            return "unprimed"
        return "near" if chance < preset.unprimed + preset.near_miss else "plain"

    def prime_time(self, reach: Reach) -> float:
        """Draw when the first look at the goal begins."""
        preset = self.plan.preset
        rng = self.rng
        if reach.twist.gap is not None:
            return reach.event - reach.twist.gap
        after_motor_start = not preset.gap
        prime = reach.motor_start + rng.normal(1.0, 0.6) if after_motor_start else reach.event - _draw_gap(preset, rng)
        latest = reach.event - (_SEEN_BEFORE_TOUCHED if after_motor_start else _GAP_LIMITS[0])
        prime = float(np.clip(prime, 0.4, latest))
        if reach.number > 0:
            previous = self.plan.reaches[reach.number - 1].event
            if previous - 0.6 <= prime <= previous + 0.15:
                prime = previous + 0.15 + float(rng.uniform(0.02, 0.1))
        index = int(np.searchsorted(self.times, prime))
        offset = reach.centre - self.base.points[index]
        bearing = wrap(np.arctan2(offset[0], offset[2]) - self.base.heading[index])
        if abs(bearing) > _WIDEST_BEARING:
            prime = max(prime, reach.motor_start + float(rng.uniform(-0.1, 0.2)))
        return min(prime, reach.event - _GAP_LIMITS[0])

    def goal_looks(self, reach: Reach, prime: float, kind: str) -> tuple[list[Look], list[Look], list[Look]]:
        """Draw prime, guide, and returns in between, in the order in which they claim time."""
        rng = self.rng
        guide = max(prime, reach.reach_start - float(rng.uniform(0.0, 0.45)))
        dwell = self.plan.preset.prime_look * np.exp(0.5 * rng.standard_normal())
        end = prime + float(np.clip(dwell, 0.25, 2.0))
        if guide - end <= 0.25:
            end = max(end, guide)
        early = rng.random() < 0.08
        leave = reach.event + (-float(rng.uniform(0.15, 0.40)) if early else float(rng.uniform(-0.05, 0.3)))
        first = self._look(prime, end, reach, kind)
        last = self._look(max(guide, end), leave, reach, "plain")
        returns = []
        now = end
        while guide - now > 0.25:
            now += float(rng.uniform(0.4, 1.5))
            if now + 0.4 < guide and rng.random() < 0.45:
                returns.append(self._look(now, now + 0.4, reach, "plain"))
                now += 0.4
        return [first], [last] if last.end > last.start else [], returns

    def sweep(self, reach: Reach, prime: float) -> tuple[list[Look], list[Look], list[Look]]:
        """Return two short looks on both sides of the goal, so that one fast saccade crosses it."""
        index = int(np.searchsorted(self.times, prime))
        sight = reach.centre - self.eye[index]
        sideways = np.tan(_SWEEP) * np.array([sight[2], 0.0, -sight[0]])
        before = Look(prime - 0.34, prime, reach.centre - sideways, False, reach.number)
        after = Look(prime, prime + 0.34, reach.centre + sideways, False, reach.number)
        return [before, after], [], []

    def _look(self, start: float, end: float, reach: Reach, kind: str) -> Look:
        point = reach.centre + 0.3 * reach.half_world * self.rng.standard_normal(3)
        if kind == "near":
            point = self._beside(start, reach)
        return Look(start, end, point, True, reach.number)

    def _beside(self, start: float, reach: Reach) -> np.ndarray:
        """Return a point that the ray passes 1 to 3.5 cm beside the box."""
        index = min(int(np.searchsorted(self.times, start)), self.times.size - 1)
        sight = reach.centre - self.eye[index]
        sideways = np.array([sight[2], 0.0, -sight[0]]) / np.hypot(sight[0], sight[2])
        if self.rng.random() < 0.5:
            sideways = -sideways
        extent = float(np.abs(sideways) @ reach.half_world)
        return reach.centre + (extent + float(self.rng.uniform(0.01, 0.035))) * sideways


def _draw_gap(preset: Preset, rng: np.random.Generator) -> float:
    """Draw a gap inside the window; what lies outside is drawn again, as clipped gaps would pile up at its end."""
    weights = np.array([part[0] for part in preset.gap])
    shortest, longest = _GAP_LIMITS
    while True:
        _, median, spread = preset.gap[int(rng.choice(len(weights), p=weights / weights.sum()))]
        gap = float(median * np.exp(spread * rng.standard_normal()))
        if shortest <= gap <= longest:
            return gap


_MARGIN = 0.05
_MARGIN_PER_METRE = 0.03
_SHIFT = (np.deg2rad(11.0), np.deg2rad(29.0))


def repaired(
    plan: Plan,
    gaze_plan: GazePlan,
    eye: Float[np.ndarray, "n 3"],
    gaze: Float[np.ndarray, "n 3"],
    times: Float[np.ndarray, " n"],
    rng: np.random.Generator,
) -> GazePlan:
    """Apply one round of repair; return the plan itself when nothing offends.

    Args:
        plan: Goals and event times.
        gaze_plan: Looks to repair.
        eye: True eye positions.
        gaze: True gaze directions that follow from the plan.
        times: Frame times, seconds.
        rng: For the size of the shifts.
    """
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
    offending = sorted(found)
    if not offending:
        return gaze_plan
    looks = list(gaze_plan.looks)
    for number in offending:
        look = looks[number]
        index = min(int(np.searchsorted(times, look.start)), times.size - 1)
        looks[number] = _moved(look, eye[index], rng)
    return replace(gaze_plan, looks=tuple(looks))


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
    """Move a look up, or down when it is already high, and to one side."""
    sight = look.point - eye
    yaw, pitch = yaw_and_pitch(sight)
    upward, sideways = rng.uniform(*_SHIFT, 2)
    pitch = pitch - upward if pitch - upward > np.deg2rad(-40.0) else pitch + upward
    yaw = yaw + (sideways if rng.random() < 0.5 else -sideways)
    return replace(look, point=eye + np.linalg.norm(sight) * direction(yaw, pitch))
