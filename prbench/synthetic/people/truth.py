"""What truly happened: event times, boxes, and when noise-free gaze first met the goal.

Sources: docs/specification/synthetic-recordings.md#event-truth and
docs/specification/synthetic-recordings.md#truth-record.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from prbench.rays import near_miss, slab_test
from prbench.skeleton import WRISTS
from prbench.synthetic.people.gaze_plan import WINDOW, GazePlan
from prbench.synthetic.people.person import SIDES
from prbench.synthetic.people.plan import Action, Plan, Reach
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent

NEAR_MISS = 0.05
_MOVED = 0.001
_LASTING = 0.050
_SETTLING = 0.100
_PREROLL = 2.0
_MINIMUM_MOVEMENT = 0.20
_GAZE_PERIOD = 1.0 / 30.0
_THIN_MOVEMENT, _THIN_RAY = 0.02, 0.005


@dataclass(frozen=True)
class Scene:
    """The finished motion, as far as truth needs it."""

    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    eye: Float[np.ndarray, "n 3"]
    gaze: Float[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Sight:
    """When and how a box is first seen before an event."""

    lasting: float | None
    """First instant of a look of at least 50 ms."""
    first: float | None
    kind: str | None
    """``hit`` if the look's first tenth of a second is mostly on the box: an arriving saccade crosses its border."""
    marginal: bool
    """So close to a border that noise decides."""


def true_events(
    plan: Plan, gaze: GazePlan, scene: Scene, objects: list[ObjectMotion], recording_id: str
) -> tuple[TrueEvent, ...]:
    """The truth about every pick, put and provocation of a recording."""
    events = []
    for reach, prime, kind in zip(plan.reaches, gaze.primes, gaze.kinds, strict=True):
        if reach.action == "hover":
            continue
        tag = reach.tag if reach.tag != "plain" else kind
        actions: tuple[Action, ...] = ("pick", "put") if reach.action == "hinge" else (reach.action,)
        for action in actions:
            moment = replace(reach, action=action)
            events.append(_true_event(moment, prime, tag, scene, objects[reach.item], recording_id))
    return tuple(events)


def events_of_others(plan: Plan, scene: Scene, objects: list[ObjectMotion], recording_id: str) -> tuple[TrueEvent, ...]:
    """What a bystander does; it belongs to the other person's recording."""
    events = [
        _true_event(reach, None, "bystander", scene, objects[reach.item], f"{recording_id}/other")
        for reach in plan.reaches
    ]
    return tuple(replace(event, expected="other_wearer") for event in events)


def _true_event(
    reach: Reach, prime: float | None, tag: str, scene: Scene, motion: ObjectMotion, recording_id: str
) -> TrueEvent:
    event_time = exact_event_time(reach, motion, scene.times)
    low, high = reach.centre - reach.half_world, reach.centre + reach.half_world
    sight = first_sight(scene, low, high, event_time)
    expected, margin = _expected(reach, sight, scene)
    return TrueEvent(
        event_id=f"{recording_id}/{reach.number:03d}{'b' if tag == 'hinge' and reach.action == 'put' else ''}",
        action="put" if reach.action == "put" else "pick",
        tag=tag,
        object_id=motion.object_id,
        object_name=motion.name,
        hand=SIDES[reach.hand],
        contact_time=float(reach.contact),
        event_time=float(event_time),
        release_time=float(reach.event) + 0.15,
        goal=reach.centre,
        box_min=low,
        box_max=high,
        prime_planned=None if prime is None else float(prime),
        prime_time=sight.lasting,
        prime_first=sight.first,
        prime_kind="hit" if sight.kind == "hit" else "near_miss" if sight.kind else None,
        motor_start=float(reach.motor_start),
        reach_start=float(reach.reach_start),
        expected=expected,
        thin=sight.marginal or margin < _THIN_MOVEMENT,
        lost_span=reach.twist.lost,
    )


def exact_event_time(reach: Reach, motion: ObjectMotion, times: np.ndarray) -> float:
    """First (pick) or last (put) instant at which the object is more than 1 mm from its rest; crossing interpolated."""
    if len(motion.position) == 1:
        return reach.event
    first, last = np.searchsorted(times, [reach.event - 1.0, reach.event + 1.5])
    rest = motion.position[-1] if reach.action == "put" else reach.centre
    away = np.linalg.norm(motion.position[first:last] - rest, axis=1)
    beyond = np.flatnonzero(away > _MOVED)
    if not beyond.size:
        return reach.event
    far = int(beyond[0] if reach.action == "pick" else beyond[-1])
    near = far - 1 if reach.action == "pick" else far + 1
    if not 0 <= near < len(away):
        return float(times[first + far])
    share = (_MOVED - away[near]) / (away[far] - away[near])
    return float(times[first + near] + share * (times[first + far] - times[first + near]))


def seen_again(
    event: TrueEvent, performance: Performance, low: np.ndarray, high: np.ndarray, *, gaze_period: float
) -> TrueEvent:
    """The same event for a dataset that knows another box of the goal, or samples gaze at another rate.

    Args:
        event: Of that performance, one that is an event.
        performance: The truth.
        low: Lower corner of the world-aligned box; equal to ``high`` for a point.
        high: Upper corner.
        gaze_period: Seconds between two gaze samples.
    """
    scene = Scene(performance.times, performance.joints, performance.eye, performance.gaze)
    sight = first_sight(scene, low, high, event.event_time, gaze_period=gaze_period)
    expected, margin = _outcome(sight, scene, (low + high) / 2)
    return replace(
        event,
        box_min=low,
        box_max=high,
        prime_time=sight.lasting,
        prime_first=sight.first,
        prime_kind="hit" if sight.kind == "hit" else "near_miss" if sight.kind else None,
        expected=expected,
        thin=sight.marginal or margin < _THIN_MOVEMENT,
    )


def first_sight(
    scene: Scene, low: np.ndarray, high: np.ndarray, event_time: float, *, gaze_period: float = _GAZE_PERIOD
) -> Sight:
    """First look at a box in the ten seconds before an event, with noise-free gaze."""
    first, last = np.searchsorted(scene.times, [event_time - WINDOW, event_time], side="left")
    last = min(int(last) + int(scene.times[min(last, scene.times.size - 1)] == event_time), scene.times.size)
    origins, directions, times = scene.eye[first:last], scene.gaze[first:last], scene.times[first:last]
    hit = slab_test(origins, directions, low[None], high[None]).hit[:, 0]
    passed = near_miss(origins, directions, low[None], high[None])
    distance = np.where(passed.along[:, 0] >= 0.0, passed.distance[:, 0], np.inf)
    seen = hit | (distance <= NEAR_MISS)
    begins = np.flatnonzero(seen & ~np.concatenate([[False], seen[:-1]]))
    ends = np.flatnonzero(seen & ~np.concatenate([seen[1:], [False]])) + 1
    step = float(scene.times[1] - scene.times[0])
    lasting = [i for i in range(len(begins)) if (ends[i] - begins[i]) * step >= _LASTING]
    start = None if not lasting else int(begins[lasting[0]])
    settling = int(np.ceil(_SETTLING / step)) + 1
    earliest = None if not len(begins) else int(begins[0])
    marginal = _is_marginal(distance, hit, times, begins, ends, start, step, event_time, gaze_period)
    return Sight(
        None if start is None else float(times[start]),
        None if earliest is None else float(times[earliest]),
        None if start is None else ("hit" if hit[start : start + settling].mean() >= 0.5 else "near_miss"),
        marginal,
    )


def _is_marginal(
    distance: np.ndarray,
    hit: np.ndarray,
    times: np.ndarray,
    begins: np.ndarray,
    ends: np.ndarray,
    start: int | None,
    step: float,
    event_time: float,
    gaze_period: float,
) -> bool:
    """Whether a gaze sample more or less, or 5 mm, would change whether and when the event is primed."""
    upto = len(times) if start is None else start
    almost = (np.abs(distance[:upto] - NEAR_MISS) < _THIN_RAY) & ~hit[:upto]
    if start is None:
        return bool(almost.any() or len(begins))
    settled = times[start] + 2 * gaze_period
    brief = bool(np.any((ends - begins) * step < 2 * gaze_period)) and begins[0] < start
    own_end = int(ends[int(np.searchsorted(begins, start))])
    brief = brief or bool((own_end - start) * step < gaze_period)
    distinct = bool(almost[: max(start - int(0.1 / step), 0)].any())
    at_border = times[start] < event_time - WINDOW + gaze_period or settled > event_time
    look = slice(start, min(start + max(2, int(2 * gaze_period / step)), len(times)))
    grazing = bool(np.all(~hit[look] & (np.abs(distance[look] - NEAR_MISS) < _THIN_RAY)))
    return bool(brief or distinct or at_border or grazing)


def _expected(reach: Reach, sight: Sight, scene: Scene) -> tuple[str, float]:
    """The outcome that curation should reach, and the margin of the minimum-movement filter in metres."""
    if reach.tag == "hinge":
        return "excluded_category", np.inf
    if reach.action not in ("pick", "put"):
        return "not_an_event", np.inf
    return _outcome(sight, scene, reach.centre)


def _outcome(sight: Sight, scene: Scene, goal: np.ndarray) -> tuple[str, float]:
    if sight.lasting is None:
        return "not_primed", np.inf
    start = sight.lasting - _PREROLL
    if start < scene.times[0]:
        return "too_short", np.inf
    wrists = scene.joints[int(np.searchsorted(scene.times, start)), WRISTS]
    nearest = float(np.linalg.norm(wrists - goal, axis=1).min())
    margin = abs(nearest - _MINIMUM_MOVEMENT)
    return ("minimum_movement" if nearest < _MINIMUM_MOVEMENT else "sequence"), margin
