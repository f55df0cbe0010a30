"""Objects that stand still, are carried in a hand, and stand still again.

Sources: docs/specification/synthetic-recordings.md#reaching-and-holding,
docs/specification/synthetic-recordings.md#event-truth and docs/specification/synthetic-recordings.md#provocations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, inf
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import WRISTS, rotation_matrices
from prbench.protocol.manifests import load_protocol
from prbench.recording import SIDES
from prbench.synthetic.people.body import HANDING_TIME, MEETING_TIME, Sides, Signal, moved_along, opened
from prbench.synthetic.people.gaze_plan import GazePlan
from prbench.synthetic.people.kinematics import minimum_jerk, quaternion, rotation
from prbench.synthetic.people.plan import Action, Plan, Reach
from prbench.synthetic.people.world import Item
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent

# Positions and rotations of one object, and which hand holds it, over time; one row for an object at rest.
_Track = tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"], Int[np.ndarray, " n"]]


def move_objects(
    plan: Plan, wrists: Sides, hands: Float[np.ndarray, "n 2 3 3"], times: Signal, object_ids: list[str]
) -> list[ObjectMotion]:
    """Return the tracks of all handled objects and of the room's bystanders.

    Args:
        plan: Which object is carried when.
        wrists: Left and right wrist.
        hands: World from hand.
        times: Frame times, seconds.
        object_ids: One for each of the plan's items.

    Returns:
        One motion for each item; an object that never moves has a single pose.
    """
    tracks: list[_Track] = []
    for index, item in enumerate(plan.items):
        reaches = [
            reach
            for reach in plan.reaches
            if reach.item == index
            and (reach.action in ("nudge", "hinge") or (plan.preset.puts and reach.action in ("pick", "put")))
        ]
        if item.rides_on is not None:
            tracks.append(_riding(item, plan.items[item.rides_on], tracks[item.rides_on]))
        elif reaches:
            tracks.append(_moving(item, reaches, wrists, hands, times))
        else:
            tracks.append(_resting(item))
    return [
        ObjectMotion(object_id, item.kind.name, item.kind.category, item.half_extents, *track, True, item.hinged)
        for item, track, object_id in zip(plan.items, tracks, object_ids, strict=True)
    ]


def _resting(item: Item) -> _Track:
    return item.position[None], quaternion(rotation(item.yaw, 0.0))[None], np.array([-1])


def _moving(item: Item, reaches: list[Reach], wrists: np.ndarray, hands: np.ndarray, times: np.ndarray) -> _Track:
    n = times.size
    position, turned, held_by = (np.repeat(part, n, axis=0) for part in _resting(item))
    for reach, following in zip(reaches, (*reaches[1:], None), strict=False):
        first = int(np.searchsorted(times, reach.event))
        if reach.action == "pick":
            last = n if following is None else int(np.searchsorted(times, following.event))
            # Fix the object in the hand; what is left at the put is spread over the carry.
            span = slice(first, last)
            places, frames = _rigid(wrists[span, reach.hand], hands[span, reach.hand], reach, at=0)
            held_by[span] = reach.hand
            if following is not None and following.handed_over is not None:
                begin = following.handed_over + MEETING_TIME
                share = minimum_jerk((times[span] - begin) / HANDING_TIME)
                other = following.hand
                places_after, frames_after = _rigid(wrists[span, other], hands[span, other], following, at=-1)
                places = places + share[:, None] * (places_after - places)
                # The rotations a growing share of the way from one to the other.
                left = quaternion(frames_after @ np.swapaxes(frames, -1, -2))
                frames = _scaled_rotation(left, share) @ frames
                held_by[span] = np.where(share < 0.5, reach.hand, other)
            if following is not None:
                progress = minimum_jerk(np.arange(len(places)) / (len(places) - 1))
                places = places + progress[:, None] * (following.centre - places[-1])
                left = quaternion(rotation(following.yaw, 0.0) @ frames[-1].T)
                frames = _scaled_rotation(np.broadcast_to(left, (len(progress), 4)), progress) @ frames
            position[span] = places
            turned[span] = quaternion(frames)
        elif reach.action == "put":
            position[first:] = reach.centre
            turned[first:] = quaternion(rotation(reach.yaw, 0.0))
        else:
            position[first:] = moved_along(reach, reach.centre, times[first:])
            if reach.action == "hinge":
                turned[first:] = quaternion(rotation(reach.yaw + opened(reach, times[first:]), 0.0))
                held_by[first : int(np.searchsorted(times, reach.event + reach.dwell))] = reach.hand
    return position, turned, held_by


def _rigid(wrist: np.ndarray, hand: np.ndarray, reach: Reach, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses of an object that is fixed in a hand and lies as the reach has it in frame ``at``."""
    offset = hand[at].T @ (reach.centre - wrist[at])
    return wrist + hand @ offset, hand @ (hand[at].T @ rotation(reach.yaw, 0.0))


def _scaled_rotation(quaternions: Float[np.ndarray, "n 4"], share: Float[np.ndarray, " n"]) -> np.ndarray:
    """Return the matrices of rotations (w >= 0) whose angles are scaled."""
    sine = np.linalg.norm(quaternions[:, 1:], axis=1)
    half = np.arctan2(sine, quaternions[:, 0]) * share
    axis = quaternions[:, 1:] / np.maximum(sine, 1e-12)[:, None]
    return rotation_matrices(np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], axis=1))


def _riding(item: Item, carrier: Item, track: _Track) -> _Track:
    """Return the poses of an object that stands on another one."""
    position, turned, _ = track
    if len(position) == 1:
        return _resting(item)
    at_rest = rotation(carrier.yaw, 0.0)
    offset = at_rest.T @ (item.position - carrier.position)
    frames = rotation_matrices(turned)
    still = np.all(position == carrier.position, axis=1)[:, None]
    places = np.where(still, item.position, position + frames @ offset)
    return places, quaternion(frames @ (at_rest.T @ rotation(item.yaw, 0.0))), np.full(len(places), -1)


# Seconds that a look lasts at least; a saccade that sweeps across the box is shorter.
_LASTING = 0.050
# Seconds from the start of a look that decide between hit and near miss.
_SETTLING = 0.100
# Metres from the near-miss border within which noise decides.
_THIN_RAY = 0.005

_Vector = Sequence[float]


@dataclass(frozen=True)
class Sight:
    """When and how a box is first seen before an event.

    Attributes:
        lasting: First instant of a look of at least 50 ms, seconds.
        first: First instant of any look, seconds.
        kind: ``hit`` if the look's first tenth of a second is mostly on the box: an arriving saccade crosses its
            border.
        marginal: True where a gaze sample more or less, or 5 mm, would change whether or when the event is primed.
    """

    lasting: float | None
    first: float | None
    kind: Literal["hit", "near_miss"] | None
    marginal: bool


def slab_interval(origin: _Vector, direction: _Vector, low: _Vector, high: _Vector) -> tuple[float, float]:
    """Return where one ray enters and leaves one axis-aligned box (equation 4).

    Args:
        origin: Ray origin (3), metres.
        direction: Unit direction (3).
        low: Lower corner of the box (3), metres, same frame.
        high: Upper corner.

    Returns:
        Distances t_near and t_far along the ray, metres; infinity and minus infinity if the ray runs beside the box.
    """
    near = -inf
    far = inf
    for start, slope, lower, upper in zip(origin, direction, low, high, strict=True):
        if slope == 0.0:
            # The ray keeps its distance from both planes: it is between them all along, or never.
            if not lower <= start <= upper:
                return inf, -inf
            continue
        one = (lower - start) / slope
        other = (upper - start) / slope
        near = max(near, min(one, other))
        far = min(far, max(one, other))
    return near, far


def meets_box(origin: _Vector, direction: _Vector, low: _Vector, high: _Vector) -> bool:
    """Return True where the ray meets the box (equation 4); arguments as for :func:`slab_interval`."""
    near, far = slab_interval(origin, direction, low, high)
    return near < far and far >= 0.0


def passing_distance(origin: _Vector, direction: _Vector, low: _Vector, high: _Vector) -> float:
    """Return how far a ray passes beside a box, metres (equations 5 to 7); arguments as for :func:`slab_interval`.

    Returns:
        The distance between the ray's point closest to the box centre and the point where the ray from there to the
        centre meets the box: 0 if the closest point lies inside, infinity if it lies behind the origin.
    """
    centre = [(lower + upper) / 2.0 for lower, upper in zip(low, high, strict=True)]
    along = 0.0
    for start, slope, middle in zip(origin, direction, centre, strict=True):
        along += (middle - start) * slope
    if along < 0.0:
        return inf
    closest = [start + along * slope for start, slope in zip(origin, direction, strict=True)]
    if all(lower <= value <= upper for lower, value, upper in zip(low, closest, high, strict=True)):
        return 0.0
    length = hypot(*(middle - value for middle, value in zip(centre, closest, strict=True)))
    to_centre = [(middle - value) / length for middle, value in zip(centre, closest, strict=True)]
    # Equation 6 casts the second ray from the centre; t_near is negative, on the side of the closest point.
    near, _ = slab_interval(centre, to_centre, low, high)
    return length + near


def first_sight(
    times: Float[np.ndarray, " n"],
    eye: Float[np.ndarray, "n 3"],
    gaze: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "3"],
    high: Float[np.ndarray, "3"],
    event_time: float,
    *,
    gaze_period: float = 1.0 / 30.0,
) -> Sight:
    """Find the first look at a box in the priming window before an event (equation 2).

    Args:
        times: Seconds, uniform.
        eye: True eye positions, metres.
        gaze: True unit gaze directions.
        low: Lower corner of the world-aligned box, metres; equal to ``high`` for a point.
        high: Upper corner.
        event_time: Seconds.
        gaze_period: Seconds between two gaze samples of the imitated dataset.
    """
    curation = load_protocol().curation
    lower = low.tolist()
    upper = high.tolist()
    step = float(times[1] - times[0])
    window_start = event_time - curation.priming_window
    # Judge every gaze sample of the window, both ends included.
    inside = (times >= window_start) & (times <= event_time)
    instants = times[inside]
    rays = list(zip(eye[inside].tolist(), gaze[inside].tolist(), strict=True))
    hits = [meets_box(origin, direction, lower, upper) for origin, direction in rays]
    distances = [passing_distance(origin, direction, lower, upper) for origin, direction in rays]
    near = curation.near_miss_distance
    seen = [hit or distance <= near for hit, distance in zip(hits, distances, strict=True)]
    # Where 5 mm decide whether the ray nearly misses the box.
    borderline = [not hit and abs(distance - near) < _THIN_RAY for hit, distance in zip(hits, distances, strict=True)]
    # First sample of each unbroken look at the box, and the sample after its last.
    borders = np.flatnonzero(np.diff([False, *seen, False]))
    looks = [(int(begin), int(stop)) for begin, stop in zip(borders[::2], borders[1::2], strict=True)]
    lasting = next((look for look in looks if (look[1] - look[0]) * step >= _LASTING), None)
    first = float(instants[looks[0][0]]) if looks else None
    if lasting is None:
        return Sight(lasting=None, first=first, kind=None, marginal=bool(looks) or any(borderline))
    begin, stop = lasting
    start = float(instants[begin])
    settling = hits[begin : begin + int(np.ceil(_SETTLING / step)) + 1]
    # The approach itself crosses the border in the last tenth of a second; only an earlier graze is another look. And
    # a look shorter than two gaze periods may be sampled or not.
    sampled = min(begin + max(2, int(2 * gaze_period / step)), len(instants))
    marginal = (
        start < window_start + gaze_period
        or start + 2 * gaze_period > event_time
        or (stop - begin) * step < gaze_period
        or (looks[0][0] < begin and any((last - place) * step < 2 * gaze_period for place, last in looks))
        or any(borderline[: max(begin - int(0.1 / step), 0)])
        or all(borderline[begin:sampled])
    )
    kind = "hit" if 2 * sum(settling) >= len(settling) else "near_miss"
    return Sight(lasting=start, first=first, kind=kind, marginal=marginal)


# Metres from its rest beyond which an object has moved.
_MOVED = 0.001
# Metres from the minimum movement within which noise decides.
_THIN_MOVEMENT = 0.02


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
    name = f"{recording_id}/other"
    events = (_true_event(each, None, "bystander", scene, objects[each.item], name) for each in plan.reaches)
    return tuple(replace(event, expected="other_wearer") for event in events)


def _true_event(
    reach: Reach, prime: float | None, tag: str, scene: Scene, motion: ObjectMotion, recording_id: str
) -> TrueEvent:
    event_time = _exact_event_time(reach, motion, scene.times)
    low = reach.centre - reach.half_world
    high = reach.centre + reach.half_world
    sight = first_sight(scene.times, scene.eye, scene.gaze, low, high, event_time)
    outcome = _outcome(sight, scene, reach.centre)
    if reach.action not in ("pick", "put") or reach.tag == "hinge":
        outcome["expected"] = "excluded_category" if reach.tag == "hinge" else "not_an_event"
        outcome["thin"] = sight.marginal
    outcome |= {"tag": tag, "object_id": motion.object_id, "object_name": motion.name, "hand": SIDES[reach.hand]}
    outcome |= {"goal": reach.centre, "box_min": low, "box_max": high, "lost_span": reach.lost}
    times = {"contact_time": reach.contact, "event_time": event_time, "release_time": reach.event + 0.15}
    times |= {"motor_start": reach.motor_start, "reach_start": reach.reach_start}
    outcome |= {name: float(time) for name, time in times.items()}
    return TrueEvent(
        event_id=f"{recording_id}/{reach.number:03d}{'b' if tag == 'hinge' and reach.action == 'put' else ''}",
        action="put" if reach.action == "put" else "pick",
        prime_planned=None if prime is None else float(prime),
        **outcome,
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
        event: A pick or put of that performance.
        performance: The truth.
        low: Lower corner of the world-aligned box; equal to ``high`` for a point.
        high: Upper corner.
        gaze_period: Seconds between two gaze samples.
    """
    scene = Scene(performance.times, performance.joints, performance.eye, performance.gaze)
    sight = first_sight(scene.times, scene.eye, scene.gaze, low, high, event.event_time, gaze_period=gaze_period)
    return replace(event, box_min=low, box_max=high, **_outcome(sight, scene, (low + high) / 2))


def _outcome(sight: Sight, scene: Scene, goal: np.ndarray) -> dict[str, Any]:
    """Return the prime and the outcome of an event with a place (docs/specification/curation.md#minimum-movement)."""
    curation = load_protocol().curation
    seen = {"prime_time": sight.lasting, "prime_first": sight.first, "prime_kind": sight.kind, "thin": sight.marginal}
    if sight.lasting is None:
        return seen | {"expected": "not_primed"}
    start = sight.lasting - curation.lead
    if start < scene.times[0]:
        return seen | {"expected": "too_short"}
    wrists = scene.joints[int(np.searchsorted(scene.times, start)), WRISTS]
    nearest = float(np.linalg.norm(wrists - goal, axis=1).min())
    outcome = "minimum_movement" if nearest < curation.minimum_movement else "sequence"
    margin = abs(nearest - curation.minimum_movement)
    return seen | {"expected": outcome, "thin": sight.marginal or margin < _THIN_MOVEMENT}
