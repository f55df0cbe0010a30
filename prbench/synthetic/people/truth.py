"""Objects that stand still, are carried in a hand, and stand still again.

Sources: docs/specification/synthetic-recordings.md#reaching-and-holding,
docs/specification/synthetic-recordings.md#event-truth and docs/specification/synthetic-recordings.md#provocations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, inf
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from prbench.geometry.skeleton import WRISTS
from prbench.protocol.manifests import load_protocol
from prbench.synthetic.people.body import HANDING_TIME, MEETING_TIME, moved_along, opened
from prbench.synthetic.people.gaze_plan import GazePlan
from prbench.synthetic.people.kinematics import matrix_of, minimum_jerk, quaternion, rotation
from prbench.synthetic.people.person import SIDES
from prbench.synthetic.people.plan import Action, Plan, Reach
from prbench.synthetic.people.world import Item
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent


@dataclass
class _Track:
    """Pose of one object over time, filled in movement by movement."""

    position: Float[np.ndarray, "n 3"]
    rotation: Float[np.ndarray, "n 4"]
    held_by: Int[np.ndarray, " n"]


def move_objects(
    plan: Plan,
    wrists: Float[np.ndarray, "n 2 3"],
    hands: Float[np.ndarray, "n 2 3 3"],
    times: Float[np.ndarray, " n"],
    object_ids: list[str],
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
        if item.rides_on is not None:
            tracks.append(_riding(item, plan.items[item.rides_on], tracks[item.rides_on]))
            continue
        reaches = [reach for reach in plan.reaches if reach.item == index and _moves_object(plan, reach)]
        tracks.append(_moving(item, reaches, wrists, hands, times) if reaches else _resting(item))
    return [
        ObjectMotion(
            object_id=object_id,
            name=item.kind.name,
            category=item.kind.category,
            half_extents=item.half_extents,
            position=track.position,
            rotation=track.rotation,
            held_by=track.held_by,
            movable=True,
            hinged=item.hinged,
        )
        for item, track, object_id in zip(plan.items, tracks, object_ids, strict=True)
    ]


def _moves_object(plan: Plan, reach: Reach) -> bool:
    return reach.action in ("nudge", "hinge") or (plan.preset.puts and reach.action in ("pick", "put"))


def _resting(item: Item) -> _Track:
    return _Track(item.position[None], quaternion(rotation(item.yaw, 0.0))[None], np.array([-1]))


def _moving(item: Item, reaches: list[Reach], wrists: np.ndarray, hands: np.ndarray, times: np.ndarray) -> _Track:
    n = times.size
    rest = _resting(item)
    track = _Track(np.tile(rest.position, (n, 1)), np.tile(rest.rotation, (n, 1)), np.full(n, -1))
    for reach, following in zip(reaches, (*reaches[1:], None), strict=False):
        first = int(np.searchsorted(times, reach.event))
        if reach.action == "pick":
            last = n if following is None else int(np.searchsorted(times, following.event))
            # Fix the object in the hand; what is left at the put is spread over the carry.
            span = slice(first, last)
            position, turned = _rigid(wrists[span, reach.hand], hands[span, reach.hand], reach, at=0)
            track.held_by[span] = reach.hand
            if following is not None and following.twist.handed_over is not None:
                begin = following.twist.handed_over + MEETING_TIME
                share = minimum_jerk((times[span] - begin) / HANDING_TIME)
                position_after, turned_after = _rigid(
                    wrists[span, following.hand], hands[span, following.hand], following, at=-1
                )
                position = position + share[:, None] * (position_after - position)
                # The rotations a growing share of the way from one to the other.
                left = quaternion(turned_after @ np.swapaxes(turned, -1, -2))
                turned = _scaled_rotation(left, share) @ turned
                track.held_by[span] = np.where(share < 0.5, reach.hand, following.hand)
            if following is not None:
                progress = minimum_jerk(np.arange(len(position)) / (len(position) - 1))
                position = position + progress[:, None] * (following.centre - position[-1])
                turned = _part_of_rotation(rotation(following.yaw, 0.0) @ turned[-1].T, progress) @ turned
            track.position[span] = position
            track.rotation[span] = quaternion(turned)
        elif reach.action == "put":
            track.position[first:] = reach.centre
            track.rotation[first:] = quaternion(rotation(reach.yaw, 0.0))
        else:
            track.position[first:] = moved_along(reach, reach.centre, times[first:])
            if reach.action == "hinge":
                track.rotation[first:] = quaternion(rotation(reach.yaw + opened(reach, times[first:]), 0.0))
                track.held_by[first : int(np.searchsorted(times, reach.event + reach.dwell))] = reach.hand
    return track


def _rigid(wrist: np.ndarray, hand: np.ndarray, reach: Reach, at: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the poses of an object that is fixed in a hand and lies as the reach has it in frame ``at``."""
    offset = hand[at].T @ (reach.centre - wrist[at])
    return wrist + hand @ offset, hand @ (hand[at].T @ rotation(reach.yaw, 0.0))


def _part_of_rotation(whole: np.ndarray, share: np.ndarray) -> np.ndarray:
    return _scaled_rotation(np.broadcast_to(quaternion(whole), (len(share), 4)), share)


def _scaled_rotation(quaternions: Float[np.ndarray, "n 4"], share: Float[np.ndarray, " n"]) -> np.ndarray:
    """Return the matrices of rotations (w >= 0) whose angles are scaled."""
    sine = np.linalg.norm(quaternions[:, 1:], axis=1)
    half = np.arctan2(sine, quaternions[:, 0]) * share
    axis = quaternions[:, 1:] / np.maximum(sine, 1e-12)[:, None]
    return matrix_of(np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axis], axis=1))


def _riding(item: Item, carrier: Item, track: _Track) -> _Track:
    """Return the poses of an object that stands on another one."""
    at_rest = rotation(carrier.yaw, 0.0)
    offset = at_rest.T @ (item.position - carrier.position)
    if len(track.position) == 1:
        return _resting(item)
    frames = matrix_of(track.rotation)
    turned = frames @ (at_rest.T @ rotation(item.yaw, 0.0))
    still = np.all(track.position == carrier.position, axis=1)[:, None]
    position = np.where(still, item.position, track.position + frames @ offset)
    return _Track(position, quaternion(turned), np.full(len(position), -1))


_LASTING = 0.050
"""Seconds that a look lasts at least; a saccade that sweeps across the box is shorter."""
_SETTLING = 0.100
"""Seconds from the start of a look that decide between hit and near miss."""
_THIN_RAY = 0.005
"""Metres from the near-miss border within which noise decides."""

_Vector = Sequence[float]


@dataclass(frozen=True)
class Sight:
    """When and how a box is first seen before an event."""

    lasting: float | None
    """First instant of a look of at least 50 ms, seconds."""
    first: float | None
    """First instant of any look, seconds."""
    kind: Literal["hit", "near_miss"] | None
    """``hit`` if the look's first tenth of a second is mostly on the box: an arriving saccade crosses its border."""
    marginal: bool
    """True where a gaze sample more or less, or 5 mm, would change whether or when the event is primed."""


@dataclass(frozen=True)
class _Samples:
    """Gaze samples of the priming window, and the looks that they form."""

    times: Float[np.ndarray, " n"]
    hits: list[bool]
    """True where the ray meets the box."""
    distances: list[float]
    """Metres between ray and box, infinite behind the eye."""
    looks: list[tuple[int, int]]
    """First sample of each unbroken look at the box, and the sample after its last."""
    step: float
    """Seconds between two samples."""

    def is_borderline(self, row: int) -> bool:
        """Return True where 5 mm decide whether the ray nearly misses the box."""
        border = load_protocol().curation.near_miss_distance
        return not self.hits[row] and abs(self.distances[row] - border) < _THIN_RAY


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
    samples = _samples(times, eye, gaze, low.tolist(), high.tolist(), event_time)
    lasting = next((look for look in samples.looks if _lasts(look, samples.step, _LASTING)), None)
    first = float(samples.times[samples.looks[0][0]]) if samples.looks else None
    if lasting is None:
        marginal = bool(samples.looks) or any(samples.is_borderline(row) for row in range(len(samples.times)))
        return Sight(lasting=None, first=first, kind=None, marginal=marginal)
    begin = lasting[0]
    settling = samples.hits[begin : begin + int(np.ceil(_SETTLING / samples.step)) + 1]
    return Sight(
        lasting=float(samples.times[begin]),
        first=first,
        kind="hit" if 2 * sum(settling) >= len(settling) else "near_miss",
        marginal=_is_marginal(samples, lasting, event_time, gaze_period),
    )


def _samples(
    times: np.ndarray, eye: np.ndarray, gaze: np.ndarray, low: _Vector, high: _Vector, event_time: float
) -> _Samples:
    """Judge every gaze sample of the window, both ends included."""
    curation = load_protocol().curation
    inside = (times >= event_time - curation.priming_window) & (times <= event_time)
    hits: list[bool] = []
    distances: list[float] = []
    looks: list[tuple[int, int]] = []
    begin: int | None = None
    for row, (origin, direction) in enumerate(zip(eye[inside].tolist(), gaze[inside].tolist(), strict=True)):
        hits.append(meets_box(origin, direction, low, high))
        distances.append(passing_distance(origin, direction, low, high))
        is_seen = hits[row] or distances[row] <= curation.near_miss_distance
        if is_seen and begin is None:
            begin = row
        if not is_seen and begin is not None:
            looks.append((begin, row))
            begin = None
    if begin is not None:
        looks.append((begin, len(hits)))
    return _Samples(times[inside], hits, distances, looks, step=float(times[1] - times[0]))


def _lasts(look: tuple[int, int], step: float, seconds: float) -> bool:
    """Return True where a look lasts at least so many seconds."""
    begin, stop = look
    return (stop - begin) * step >= seconds


def _is_marginal(samples: _Samples, lasting: tuple[int, int], event_time: float, gaze_period: float) -> bool:
    """Return True where a sample more or less, or 5 mm, would change when the event is primed."""
    begin, _ = lasting
    start = float(samples.times[begin])
    window_start = event_time - load_protocol().curation.priming_window
    if start < window_start + gaze_period or start + 2 * gaze_period > event_time:
        return True
    if not _lasts(lasting, samples.step, gaze_period):
        return True
    # A look shorter than two gaze periods may be sampled or not.
    has_brief_look = any(not _lasts(look, samples.step, 2 * gaze_period) for look in samples.looks)
    if has_brief_look and samples.looks[0][0] < begin:
        return True
    # The approach itself crosses the border in the last tenth of a second; only an earlier graze is another look.
    if any(samples.is_borderline(row) for row in range(begin - int(0.1 / samples.step))):
        return True
    stop = min(begin + max(2, int(2 * gaze_period / samples.step)), len(samples.times))
    return all(samples.is_borderline(row) for row in range(begin, stop))


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
