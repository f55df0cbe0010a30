"""Looks that are not at a goal: along the path, at the own hands, around the room, at other goals.

Source: docs/specification/synthetic-recordings.md#eye-head-trunk, points 5 and 6 of the schedule.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.kinematics import direction, wrap, yaw_and_pitch
from prbench.synthetic.people.person import Preset
from prbench.synthetic.people.plan import Plan, Reach
from prbench.synthetic.people.walking import BasePath

Signal = Float[np.ndarray, " n"]  # one number a time
Points = Float[np.ndarray, "n 3"]  # metres, or unit directions

_LONGEST_FILL = 1.6  # s
_SHORTEST_FILL = 0.15
_WALKING = 0.3  # metres per second
_BEARING_AT_START = np.deg2rad(69.0)
_BEARING_AT_END = np.deg2rad(86.0)
_SMALL_SHIFT = np.deg2rad(28.0)
_TRIES = 14


_SHORTEST_LOOK = 0.15  # s
# Seconds before an event in which a look can prime.
WINDOW = 10.0
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
    """Fixations in order of time without gaps, and the planned prime of every reach (None: not primed).

    Attributes:
        kinds: ``plain``, ``near``, ``unprimed``, ``swept`` or ``unseen`` (no rule either way) for every reach.
    """

    looks: tuple[Look, ...]
    primes: tuple[float | None, ...]
    kinds: tuple[str, ...]


Fill = Callable[[float, float, np.ndarray | None], tuple[float, np.ndarray]]


def plan_gaze(plan: Plan, base: BasePath, eye: Points, times: Signal, rng: np.random.Generator) -> GazePlan:
    """Schedule all looks of a recording.

    Args:
        plan: Events and their times.
        base: Base pose at every frame.
        eye: About where the eyes will be.
        times: Frame times, seconds.
        rng: The recording's gaze generator.
    """
    scheduler = _Scheduler(plan, base, eye, times, rng)
    kinds = tuple(scheduler.kind(reach) for reach in plan.reaches)
    both = zip(plan.reaches, kinds, strict=True)
    primes = tuple(None if kind in ("unprimed", "unseen") else scheduler.prime_time(reach) for reach, kind in both)
    together = list(zip(plan.reaches, primes, kinds, strict=True))
    asked = [
        scheduler.sweep(reach, prime) if kind == "swept" else scheduler.goal_looks(reach, prime, kind)
        for reach, prime, kind in together
        if prime is not None
    ]
    # All first looks claim their time before any guiding look does, and those before returns: looks never overlap, and
    # who comes first keeps the time.
    goals: list[Look] = []
    for look in (look for priority in range(3) for parts in asked for look in parts[priority]):
        free = [(look.start, look.end)]
        for other in goals:
            free = [
                piece
                for begin, stop in free
                for piece in ((begin, min(stop, other.start)), (max(begin, other.end), stop))
                if piece[1] - piece[0] > 1e-9
            ]
        goals += [replace(look, start=begin, end=stop) for begin, stop in free if stop - begin >= _SHORTEST_LOOK]
    # No fill may look at a goal before its planned prime, lest it prime the event.
    for reach, prime, kind in together:
        if kind != "unseen":
            until = reach.event if prime is None or kind == "swept" else prime
            scheduler.avoid.append((reach.centre, reach.event - WINDOW, until))
    return GazePlan(filled(goals, float(times[-1]), scheduler.fill), primes, kinds)


def filled(goals: list[Look], end: float, fill: Fill) -> tuple[Look, ...]:
    """Return looks in order of time, with others wherever none is planned.

    Args:
        goals: The planned looks, without overlaps.
        end: Last instant that is filled, seconds.
        fill: Draws duration and point of a look, from when it begins, when it ends at the latest, and the point before.
    """
    looks: list[Look] = []
    now = 0.0
    last = Look(end, end, np.zeros(3), False, None)
    for goal in (*sorted(goals, key=lambda look: look.start), last):
        while goal.start - now > 1e-9:
            duration, point = fill(now, goal.start, looks[-1].point if looks else None)
            looks.append(Look(now, now + duration, point, False, None))
            now += duration
        if goal is not last:
            looks.append(goal)
            now = goal.end
    return tuple(looks)


@dataclass(eq=False, repr=False)
class _Scheduler:
    """Looks at goals and fills between them (docs/specification/synthetic-recordings.md#eye-head-trunk)."""

    plan: Plan
    base: BasePath
    eye: np.ndarray
    times: np.ndarray
    rng: np.random.Generator
    avoid: list[tuple[np.ndarray, float, float]] = field(default_factory=list, init=False)
    """Goals that no fill may look at, from when on, and until when."""

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
        if reach.gap is not None:
            return reach.event - reach.gap
        after_motor_start = not preset.gap
        prime = reach.motor_start + rng.normal(1.05, 0.6) if after_motor_start else reach.event - _draw_gap(preset, rng)
        latest = reach.event - (_SEEN_BEFORE_TOUCHED if after_motor_start else _GAP_LIMITS[0])
        prime = float(np.clip(prime, 0.4, latest))
        if reach.number > 0:
            previous = self.plan.reaches[reach.number - 1].event
            if previous - 0.6 <= prime <= previous + 0.15:
                prime = previous + 0.15 + float(rng.uniform(0.02, 0.1))
        index = int(np.searchsorted(self.times, prime))
        offset = reach.centre - self.base.points[index]
        if abs(wrap(np.arctan2(offset[0], offset[2]) - self.base.heading[index])) > _WIDEST_BEARING:
            prime = max(prime, reach.motor_start + float(rng.uniform(-0.1, 0.2)))
        return min(prime, reach.event - _GAP_LIMITS[0])

    def goal_looks(self, reach: Reach, prime: float, kind: str) -> tuple[list[Look], list[Look], list[Look]]:
        """Draw prime, guide, and returns in between, in the order in which they claim time."""
        rng = self.rng
        guide = max(prime, reach.reach_start - float(rng.uniform(0.2, 0.9)))
        end = prime + float(np.clip(self.plan.preset.prime_look * np.exp(0.5 * rng.standard_normal()), 0.25, 2.0))
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
        sight = reach.centre - self.eye[int(np.searchsorted(self.times, prime))]
        sideways = np.tan(_SWEEP) * np.array([sight[2], 0.0, -sight[0]])
        before = Look(prime - 0.34, prime, reach.centre - sideways, False, reach.number)
        return [before, Look(prime, prime + 0.34, reach.centre + sideways, False, reach.number)], [], []

    def _look(self, start: float, end: float, reach: Reach, kind: str) -> Look:
        point = reach.centre + 0.3 * reach.half_world * self.rng.standard_normal(3)
        if kind == "near":
            # A point that the ray passes 1 to 3.5 cm beside the box.
            sight = reach.centre - self.eye[self._frame(start)]
            sideways = np.array([sight[2], 0.0, -sight[0]]) / np.hypot(sight[0], sight[2])
            if self.rng.random() < 0.5:
                sideways = -sideways
            extent = float(np.abs(sideways) @ reach.half_world)
            point = reach.centre + (extent + float(self.rng.uniform(0.01, 0.035))) * sideways
        return Look(start, end, point, True, reach.number)

    def _frame(self, time: float) -> int:
        return min(int(np.searchsorted(self.times, time)), self.times.size - 1)

    def fill(self, now: float, until: float, previous: np.ndarray | None) -> tuple[float, np.ndarray]:
        """Draw duration and point of the fill that begins ``now`` and ends by ``until``."""
        index = self._frame(now)
        walking = bool(self.base.speed[index] > _WALKING)
        duration = 0.38 * np.exp(0.55 * self.rng.standard_normal())
        duration = float(np.clip(duration, _SHORTEST_FILL, 0.6 if walking else _LONGEST_FILL))
        if until - now - duration < _SHORTEST_FILL:
            duration = until - now
        # The goals that would be primed by a look in this interval.
        end = now + duration
        avoided = np.array([point for point, start, stop in self.avoid if start <= end + 0.1 and stop >= now])
        last = self._frame(end)
        point = self._ahead(index)
        for attempt in range(_TRIES):
            near = duration < 0.35 and attempt < _TRIES // 2
            point = self._candidate(index, walking, previous if near else None)
            is_seen = self._bearing(point, index) <= _BEARING_AT_START and self._bearing(point, last) <= _BEARING_AT_END
            if is_seen and self._misses(point, index, avoided):
                return duration, point
        # Some direction within sight that misses every avoided goal, the nearest found to straight ahead.
        for sideways in (0.0, 0.35, -0.35, 0.7, -0.7, 1.0, -1.0):
            for pitch in (0.1, -0.25, 0.5, 0.8):
                ahead = self.eye[index] + 1.5 * direction(self.base.heading[index] + sideways, pitch)
                if self._misses(ahead, index, avoided):
                    return duration, ahead
        return duration, point

    def _candidate(self, index: int, walking: bool, previous: np.ndarray | None) -> np.ndarray:
        rng = self.rng
        eye = self.eye[index]
        if previous is not None:
            # In nearly the same direction.
            sight = previous - eye
            distance = float(np.linalg.norm(sight))
            yaw = np.arctan2(sight[0], sight[2]) + rng.uniform(-1.0, 1.0) * _SMALL_SHIFT * 0.8
            pitch = -np.arcsin(sight[1] / distance) + rng.uniform(-1.0, 1.0) * _SMALL_SHIFT * 0.4
            point = eye + distance * direction(yaw, np.clip(pitch, -0.5, 1.2))
        elif walking and rng.random() < 0.5:
            point = self._ahead(index)
        elif rng.random() < self.plan.preset.work_looks:
            # The work area, or the own hands.
            heading = self.base.heading[index] + rng.uniform(-0.5, 0.5)
            point = eye + rng.uniform(0.25, 0.55) * direction(heading, 0.0)
            point[1] = eye[1] - rng.uniform(0.38, 0.62)
        elif rng.random() < 0.5 and self.plan.reaches:
            goal = self.plan.reaches[int(rng.integers(len(self.plan.reaches)))]
            point = goal.centre + 0.3 * goal.half_world * rng.standard_normal(3)
        else:
            # Anywhere around.
            heading = self.base.heading[index] + rng.uniform(-1.0, 1.0) * _BEARING_AT_START
            distance = rng.uniform(0.6, 2.5)
            point = eye + distance * direction(heading, 0.0)
            point[1] = max(0.05, eye[1] - rng.uniform(-0.2, 0.75) * min(distance, 1.2))
        distance = float(np.linalg.norm(point - eye))
        if walking and distance < 1.0:
            return eye + (point - eye) * (rng.uniform(2.0, 4.0) / distance)
        return point

    def _ahead(self, index: int) -> np.ndarray:
        """Return a point along the path as it will be in 1.2 s."""
        soon = min(index + int(1.2 / (self.times[1] - self.times[0])), self.times.size - 1)
        point = self.base.points[soon] + self.rng.uniform(1.2, 3.0) * direction(self.base.heading[soon], 0.0)
        point[1] = self.eye[index, 1] - self.rng.uniform(0.1, 0.9)
        return point

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
    plan: Plan, gaze_plan: GazePlan, eye: Points, gaze: Points, times: Signal, rng: np.random.Generator
) -> GazePlan:
    """Apply one round of repair; return the plan itself when nothing offends.

    Args:
        plan: Goals and event times.
        gaze_plan: Looks to repair.
        eye: True eye positions.
        gaze: True gaze directions that follow from the plan.
        times: Frame times, seconds.
        rng: Generator of the size of the shifts.
    """
    starts = np.array([look.start for look in gaze_plan.looks])
    found: set[int] = set()
    for reach, prime, kind in zip(plan.reaches, gaze_plan.primes, gaze_plan.kinds, strict=True):
        if kind == "unseen":
            continue
        until = reach.event if prime is None or kind == "swept" else prime
        first, last = np.searchsorted(times, [reach.event - WINDOW, until])
        close = _passes_close(eye[first:last], gaze[first:last], reach.centre, reach.half_world)
        numbers = np.unique(np.searchsorted(starts, times[first:last][close], side="right") - 1)
        fills = [not gaze_plan.looks[n].is_goal and gaze_plan.looks[n].reach is None for n in numbers]
        found.update(numbers[fills].tolist())
    if not found:
        return gaze_plan
    looks = list(gaze_plan.looks)
    for number in sorted(found):
        # Up, or down when it is already high, and to one side.
        look = looks[number]
        from_eye = eye[min(int(np.searchsorted(times, look.start)), times.size - 1)]
        sight = look.point - from_eye
        yaw, pitch = yaw_and_pitch(sight)
        upward, sideways = rng.uniform(*_SHIFT, 2)
        pitch = pitch - upward if pitch - upward > np.deg2rad(-40.0) else pitch + upward
        yaw = yaw + (sideways if rng.random() < 0.5 else -sideways)
        looks[number] = replace(look, point=from_eye + np.linalg.norm(sight) * direction(yaw, pitch))
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
