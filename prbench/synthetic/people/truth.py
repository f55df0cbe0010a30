"""The truth about a performance: event times, boxes, and when noise-free gaze first met the goal.

Sources: docs/specification/synthetic-recordings.md#event-truth and
docs/specification/synthetic-recordings.md#truth-record.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS
from prbench.protocol.manifests import load_protocol
from prbench.synthetic.people.gaze_plan import GazePlan
from prbench.synthetic.people.person import SIDES
from prbench.synthetic.people.plan import Action, Plan, Reach
from prbench.synthetic.people.sight import Sight, first_sight
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent

_MOVED = 0.001
"""Metres from its rest beyond which an object has moved."""
_THIN_MOVEMENT = 0.02
"""Metres from the minimum movement within which noise decides."""


@dataclass(frozen=True)
class Scene:
    """The finished motion, as far as truth needs it."""

    times: Float[np.ndarray, " n"]
    joints: Float[np.ndarray, "n 22 3"]
    eye: Float[np.ndarray, "n 3"]
    gaze: Float[np.ndarray, "n 3"]


def true_events(
    plan: Plan, gaze: GazePlan, scene: Scene, objects: list[ObjectMotion], recording_id: str
) -> tuple[TrueEvent, ...]:
    """Return the truth about every pick, put and provocation of a recording."""
    events = []
    for reach, prime, kind in zip(plan.reaches, gaze.primes, gaze.kinds, strict=True):
        if reach.action == "hover":
            continue  # a hovering hand moves nothing; the pick after it is the event
        tag = reach.tag if reach.tag != "plain" else kind
        actions: tuple[Action, ...] = ("pick", "put") if reach.action == "hinge" else (reach.action,)
        for action in actions:
            moment = replace(reach, action=action)
            events.append(_true_event(moment, prime, tag, scene, objects[reach.item], recording_id))
    return tuple(events)


def events_of_others(plan: Plan, scene: Scene, objects: list[ObjectMotion], recording_id: str) -> tuple[TrueEvent, ...]:
    """Return what a bystander does; it belongs to the other person's recording."""
    events = [
        _true_event(reach, None, "bystander", scene, objects[reach.item], f"{recording_id}/other")
        for reach in plan.reaches
    ]
    return tuple(replace(event, expected="other_wearer") for event in events)


def _true_event(
    reach: Reach, prime: float | None, tag: str, scene: Scene, motion: ObjectMotion, recording_id: str
) -> TrueEvent:
    event_time = _exact_event_time(reach, motion, scene.times)
    low = reach.centre - reach.half_world
    high = reach.centre + reach.half_world
    sight = first_sight(scene.times, scene.eye, scene.gaze, low, high, event_time)
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
        prime_kind=sight.kind,
        motor_start=float(reach.motor_start),
        reach_start=float(reach.reach_start),
        expected=expected,
        thin=sight.marginal or margin < _THIN_MOVEMENT,
        lost_span=reach.twist.lost,
    )


def _exact_event_time(reach: Reach, motion: ObjectMotion, times: np.ndarray) -> float:
    """Return the first (pick) or last (put) instant at which the object is 1 mm from its rest, interpolated."""
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
    """Return the same event for a dataset that knows another box of the goal, or samples gaze at another rate.

    Args:
        event: Of that performance, one that is an event.
        performance: The truth.
        low: Lower corner of the world-aligned box; equal to ``high`` for a point.
        high: Upper corner.
        gaze_period: Seconds between two gaze samples.
    """
    scene = Scene(performance.times, performance.joints, performance.eye, performance.gaze)
    sight = first_sight(scene.times, scene.eye, scene.gaze, low, high, event.event_time, gaze_period=gaze_period)
    expected, margin = _outcome(sight, scene, (low + high) / 2)
    return replace(
        event,
        box_min=low,
        box_max=high,
        prime_time=sight.lasting,
        prime_first=sight.first,
        prime_kind=sight.kind,
        expected=expected,
        thin=sight.marginal or margin < _THIN_MOVEMENT,
    )


def _expected(reach: Reach, sight: Sight, scene: Scene) -> tuple[str, float]:
    """Return the outcome that curation should reach, and the margin of the minimum-movement filter in metres."""
    if reach.tag == "hinge":
        return "excluded_category", np.inf
    if reach.action not in ("pick", "put"):
        return "not_an_event", np.inf
    return _outcome(sight, scene, reach.centre)


def _outcome(sight: Sight, scene: Scene, goal: np.ndarray) -> tuple[str, float]:
    """Return the outcome of an event with a place (docs/specification/curation.md#minimum-movement), and its margin."""
    curation = load_protocol().curation
    if sight.lasting is None:
        return "not_primed", np.inf
    start = sight.lasting - curation.lead
    if start < scene.times[0]:
        return "too_short", np.inf
    wrists = scene.joints[int(np.searchsorted(scene.times, start)), WRISTS]
    nearest = float(np.linalg.norm(wrists - goal, axis=1).min())
    outcome = "minimum_movement" if nearest < curation.minimum_movement else "sequence"
    return outcome, abs(nearest - curation.minimum_movement)
