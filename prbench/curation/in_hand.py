"""Find when somebody's hand holds an object, by the manifest's rule, and where the object rests before and after.

Source: docs/specification/curation.md#in-hand-segmentation. Distances from a hand to an object's box, origin or surface
are masks over time. Where the object was not tracked, the hands tell when in the gap the event happened.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.errors import UsageError
from prbench.geometry.shapes import TriangleMesh
from prbench.geometry.timelines import covered, interpolate
from prbench.protocol.manifests import InHandRule
from prbench.recording import HandStream, ObjectTrack, Recording, Side

Frames = Bool[np.ndarray, " n"]  # a value a frame
Numbers = Float[np.ndarray, " n"]
Points = Float[np.ndarray, "n 3"]
Rotations = Float[np.ndarray, "n 4"]

_LONGEST_REST = 1.0  # seconds of rest that are averaged: enough to suppress sensor noise, short enough to be local


# Times the median distance of resting samples from their centre: 4 standard deviations of isotropic noise.
_STANDS_OUT = 2.6
# Share of the tolerance below which no movement is looked for, however quiet the rest: 1 mm of 2.5 mm.
_FINEST_LEVEL = 0.4
# Seconds; within a longer gap in the track, interpolation says nothing about when the movement began.
LONGEST_SURE_GAP = 0.1
_SAME_PLACE = 0.003  # metres; how exactly a hand has to come to where it held the object at rest
_RATE = 120.0
_LONGEST_HAND_GAP = 0.1


@dataclass(frozen=True)
class Departure:
    """An object leaves its rest (or, seen backwards in time, comes to rest).

    Attributes:
        time: Beginning of the movement, seconds: see :func:`find_departure`.
        gap: Times of the last sample at rest and of the first away from it, seconds.
        first_away: Centre of the box at the latter.
        centre: Median centre of the box during the rest.
        position: Median position of the object's origin during the rest.
        rotation: Mean orientation of the rest, w x y z.
        placed: False where the object was not tracked in the gap, and nothing tells when in it the movement began.
    """

    time: float
    gap: tuple[float, float]
    first_away: Float[np.ndarray, "3"]
    centre: Float[np.ndarray, "3"]
    position: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "4"]
    placed: bool = True

    @property
    def gap_length(self) -> float:
        """Seconds between the two samples."""
        return abs(self.gap[1] - self.gap[0])


@dataclass(frozen=True)
class Track:
    """The valid samples of one object: times, centre of the box, pose, and the window of its speed in seconds."""

    times: Numbers
    centre: Points
    position: Points
    rotation: Rotations
    window: float


def find_departure(
    track: Track, still: Frames, start: int, stop: int, *, floor: int, tolerance: float
) -> Departure | None:
    """Return the last rest before a holding, and the instant at which the object leaves it.

    From the start of the holding the search goes back to the last ``still`` sample; the still run that ends there is
    the rest. It has surely left once it is twice ``tolerance`` away; the boundary is where, on its way there, it passed
    the level at which a movement stands out from the noise of this rest, at most ``tolerance``. (An object that creeps
    away or settles slowly is 2.5 mm from its rest up to 0.1 s after its movement began or before it ends.)
    For the rest *after* a holding call this with everything reversed.

    Args:
        track: The object's samples.
        still: Samples at which it moves slowly, or not at all.
        start: First sample of the holding.
        stop: End of the holding (exclusive).
        floor: First sample that may belong to the rest (the end of the holding before).
        tolerance: Metres.

    Returns:
        None if the object is never still between ``floor`` and ``start``, or never leaves that rest.
    """
    resting = np.flatnonzero(still[floor : start + 1]) + floor
    if len(resting) == 0:
        return None
    last = int(resting[-1])
    moving_before = np.flatnonzero(~still[floor:last])
    first = floor if len(moving_before) == 0 else floor + int(moving_before[-1]) + 1
    # The quiet part of the still run lies before its end by half a window; at most its last second is averaged.
    quiet_stop = int(np.searchsorted(track.times, track.times[last] - track.window / 2, side="right"))
    quiet_stop = quiet_stop if quiet_stop > first else last + 1
    begin = int(np.searchsorted(track.times, track.times[quiet_stop - 1] - _LONGEST_REST))
    quiet = slice(max(first, begin), quiet_stop)
    # Medians, because trackers jump now and then even while an object lies still.
    rest = np.median(track.centre[quiet], axis=0)
    distance = np.linalg.norm(track.centre[:stop] - rest, axis=1)
    away = np.flatnonzero(distance[last:] > 2 * tolerance) + last
    if len(away) == 0:
        return None
    # The last still sample looks half a window ahead, so the way out may begin before it: where the quiet part ends.
    way = slice(min(quiet.stop, int(away[0])) - 1, int(away[0]) + 1)
    level = float(np.clip(_STANDS_OUT * float(np.median(distance[quiet])), _FINEST_LEVEL * tolerance, tolerance))
    # The passage of the level that counts is the first one after the last sample within half of it: who turns back
    # half-way has not left, who dips just below the level has.
    times = track.times[way]
    out = distance[way]
    close = np.flatnonzero(out[:-1] <= level / 2)
    home = int(close[-1]) if len(close) else 0
    inner = home + int(np.flatnonzero(out[home + 1 :] > level)[0])
    # Where tracking was lost on the way, and the object was not away before, it left while nobody saw it.
    unseen = np.flatnonzero((np.diff(times) > LONGEST_SURE_GAP) & (out[:-1] <= tolerance))
    inner = max(inner, int(unseen[-1])) if len(unseen) else inner
    share = np.clip((level - out[inner]) / max(out[inner + 1] - out[inner], 1e-12), 0.0, 1.0)
    left = float(times[inner] + share * (times[inner + 1] - times[inner]))
    gap = (float(times[inner]), float(times[inner + 1]))
    position = np.median(track.position[quiet], axis=0)
    rotation = Rotation.from_quat(track.rotation[quiet], scalar_first=True).mean().as_quat(scalar_first=True)
    return Departure(left, gap, track.centre[way.start + inner + 1], rest, position, rotation)


def placed_in_gap(departure: Departure, hands: tuple[HandStream, ...], distance: float) -> Departure:
    """Put an instant that falls into a tracking gap where the hand says it was.

    A held object moves with the hand that is nearest to it on the far side of the gap, and however it turns, its centre
    stays equally far from that hand. So the object can have been at its rest only while the hand was that far from the
    rest; within that time, it left when the hand's path, shifted to meet the object on the far side, leaves the point
    where it comes nearest to the rest. If the hand never comes that near, up to ``distance``, the middle of the gap is
    given and the departure marked as not placed.

    Args:
        departure: The instant and its gap, from the sample at rest to the one away from it (backwards for a put).
        hands: Contact points that may have held the object.
        distance: Metres.
    """
    rest_time, away_time = departure.gap
    if departure.gap_length <= LONGEST_SURE_GAP:
        return departure
    # From the far side to the rest.
    times = np.linspace(away_time, rest_time, int(np.ceil(departure.gap_length * _RATE)) + 1)
    measured = [hand for hand in hands if covered(hand.times, hand.valid, times, max_gap=_LONGEST_HAND_GAP).all()]
    paths = [interpolate(hand.times[hand.valid], hand.points[hand.valid].mean(axis=1), times) for hand in measured]
    if paths:
        path = min(paths, key=lambda path: float(np.linalg.norm(path[0] - departure.first_away)))
        reach = float(np.linalg.norm(path[0] - departure.first_away))
        excess = np.linalg.norm(path - departure.centre, axis=1) - reach
        nearest = max(float(excess.min()), 0.0)
        if nearest < distance:
            apart = np.linalg.norm(departure.first_away + path - path[0] - departure.centre, axis=1)
            apart[excess > nearest + _SAME_PLACE] = np.inf
            return replace(departure, time=float(times[np.flatnonzero(apart <= apart.min() + _SAME_PLACE)[0]]))
    return replace(departure, time=(rest_time + away_time) / 2, placed=False)


_SLACK = 1e-6  # seconds; times are computed, so equality needs room
# Seconds; hand samples further apart are not interpolated. Long enough that a holding survives the stretches of
# implausible poses that a noisy suit gives: who holds something before and after holds it in between.
_LONGEST_CONTACT_GAP = 1.0
# Seconds; a hand that is close to an object on both sides of a stretch without measurements never left it (hands leave
# the view of the glasses while they carry something).
_LONGEST_UNSEEN = 2.0
# Seconds for which an object that rests on something keeps its place; a hand that holds something sways more.
_SHORTEST_REST = 1.0
# Times the rule's distance within which a hand goes on with a holding, but does not begin one.
_STAYS_WITHIN = 1.5
# Bounds the memory that meshes of hands need.
_VERTICES_AT_ONCE = 200_000


def runs(mask: Frames) -> Int[np.ndarray, "k 2"]:
    """First index and end (exclusive) of every run of True, in order."""
    edges = np.diff(np.concatenate(([0], mask.astype(np.int8), [0])))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)])


def held_segments(
    held: Frames, staying: Frames, times: Numbers, *, minimum_duration: float, join_gap: float
) -> Int[np.ndarray, "k 2"]:
    """Return holdings from raw per-sample evidence (docs/specification/curation.md#in-hand-segmentation).

    Neighbouring runs of ``held`` that are at most ``join_gap`` apart are one piece; pieces shorter than
    ``minimum_duration`` are dropped (debounce); two that are left are joined where every sample between them is
    ``staying`` (hysteresis: it takes more to begin a holding than to go on with one).

    Args:
        held: Samples at which the object is surely held: a hand is close and the object moves.
        staying: Samples that do not end a holding: the hand stays close.
        times: Strictly increasing, seconds.
        minimum_duration: Shortest piece that counts, seconds.
        join_gap: Longest interruption that is bridged whatever happens in it, seconds.

    Returns:
        First index and end (exclusive) of each holding, in order, without overlap.
    """
    pieces = runs(held)
    pieces = _joined(pieces, times[pieces[1:, 0]] - times[pieces[:-1, 1] - 1] <= join_gap + _SLACK)
    # A tracking gap beside a piece counts as part of it: the object was moved in there, too.
    ends = pieces - np.array([0, 1])
    beyond = np.clip(pieces - np.array([1, 0]), 0, len(times) - 1)
    across = staying[beyond] & (np.abs(times[beyond] - times[ends]) > LONGEST_SURE_GAP + _SLACK)
    lasting = np.diff(times[np.where(across, beyond, ends)], axis=1)[:, 0]
    pieces = pieces[lasting >= minimum_duration - _SLACK]
    # Counts of samples that end a holding; equal counts on both sides of a gap mean none in it.
    left_before = np.concatenate(([0], np.cumsum(~staying)))
    return _joined(pieces, left_before[pieces[1:, 0]] == left_before[pieces[:-1, 1]])


def _joined(pieces: Int[np.ndarray, "k 2"], together: Bool[np.ndarray, " gaps"]) -> Int[np.ndarray, "m 2"]:
    """Pieces with the gaps between them closed where ``together`` says so; one entry a gap."""
    if len(pieces) == 0:
        return pieces
    starts = pieces[np.concatenate(([True], ~together)), 0]
    return np.column_stack([starts, pieces[np.concatenate((~together, [True])), 1]])


def contact_streams(recording: Recording, rule: InHandRule) -> tuple[HandStream, ...]:
    """Return the contact points of the rule: the wearer's, then everybody else's."""
    others = (hand for person in recording.other_people for hand in person.hands if hand.contact == rule.contact)
    return (*recording.hand_streams(rule.contact), *others)


def contact_distance(
    hand: HandStream, track: ObjectTrack, rule: InHandRule, times: Numbers, position: Points, rotation: Rotations
) -> Numbers:
    """Distance of the hand's nearest contact point to the object at given poses, metres; inf where unmeasured.

    An object without surface stands in with its box where the rule asks for surfaces.
    Where no point is within ``rule.distance`` of the box, the distance to the box is given: the surface is not nearer.

    Args:
        hand: Contact points of one hand.
        track: The object, for its box and its surface.
        rule: What counts: the oriented box, the origin, the surface.
        times: Seconds, any order.
        position: Position of the object at ``times``.
        rotation: Its orientation, w x y z.

    Raises:
        MissingExtraError: if the rule asks for a surface, and Open3D is not installed.
    """
    measured = covered(hand.times, hand.valid, times, max_gap=_LONGEST_CONTACT_GAP)
    if not measured.any():
        return np.full(len(times), np.inf)
    surface = TriangleMesh(*track.surface) if rule.target == "surface" and track.surface is not None else None
    rows = max(1, _VERTICES_AT_ONCE // hand.points.shape[1])
    nearest = np.empty(len(times))
    for start in range(0, len(times), rows):
        part = slice(start, start + rows)
        offset = interpolate(hand.times[hand.valid], hand.points[hand.valid], times[part]) - position[part, None]
        if rule.target == "origin":
            nearest[part] = np.linalg.norm(offset, axis=-1).min(axis=1)
            continue
        object_from_world = Rotation.from_quat(rotation[part], scalar_first=True).as_matrix().transpose(0, 2, 1)
        local = np.einsum("nij,nkj->nki", object_from_world, offset)
        outside = np.maximum(np.maximum(track.box_min - local, local - track.box_max), 0.0)
        distance = np.linalg.norm(outside, axis=-1)
        if surface is not None:
            # The box holds the surface, so a point outside its reach needs no look at triangles.
            near = distance < rule.distance
            distance[near] = surface.distance(local[near])
        nearest[part] = distance.min(axis=1)
    return np.where(measured, nearest, np.inf)


def close_to(distance: Numbers, times: Numbers, resting: Frames, limit: float) -> Frames:
    """Return samples at which one hand is close: nearer than the limit, or surely so though unseen.

    A hand that leaves the sight while it is close goes on holding the object until that rests, and one that comes into
    sight close to an object held it all the way from its rest: things do not move alone.

    Args:
        distance: Distance of that hand, metres; inf where it was not measured.
        times: Seconds.
        resting: Samples at which the object rests (:func:`rests`).
        limit: Metres.
    """
    close = distance < limit
    for start, stop in runs(~np.isfinite(distance)):
        before = start > 0 and close[start - 1]
        after = stop < len(times) and close[stop]
        at_rest = np.flatnonzero(resting[start:stop]) + start
        if len(at_rest) == 0 or (before and after and times[stop] - times[start - 1] <= _LONGEST_UNSEEN):
            close[start:stop] = before or after
            continue
        if before:
            close[start : at_rest[0]] = True
        if after:
            close[at_rest[-1] + 1 : stop] = True
    return close


def rests(times: Numbers, centre: Points, still: Frames, tolerance: float) -> Frames:
    """Return samples at which an object rests on something: it keeps its place, which no hand that holds it does.

    Args:
        times: Seconds.
        centre: Middle of its box, metres.
        still: Samples at which it moves slowly, or not at all.
        tolerance: Metres that it may be away from its median place.
    """
    resting = np.zeros(len(times), dtype=bool)
    for start, stop in runs(still):
        apart = np.linalg.norm(centre[start:stop] - np.median(centre[start:stop], axis=0), axis=1)
        # The tracker jumps now and then, so one sample in twenty does not count.
        stays = times[stop - 1] - times[start] >= _SHORTEST_REST and np.quantile(apart, 0.95) <= tolerance
        resting[start:stop] = stays or start == 0 or stop == len(times)
    return resting


def nearest_hand(
    hands: tuple[HandStream, ...], track: ObjectTrack, rule: InHandRule, time: float, pose: Departure
) -> tuple[Side | None, float]:
    """Return side and distance of the hand nearest to an object at one instant; (None, inf) if none is measured."""
    at = (np.array([time]), pose.position[None], pose.rotation[None])
    distances = [float(contact_distance(hand, track, rule, *at)[0]) for hand in hands]
    if not distances or not np.isfinite(min(distances)):
        return None, float("inf")
    nearest = int(np.argmin(distances))
    return hands[nearest].side, distances[nearest]


@dataclass(frozen=True)
class Holding:
    """One object taken from a rest, moved, and brought to another rest.

    Attributes:
        track: The object.
        pick: The pick; None where the object was in hand, or moving, when the recording began.
        put: The put; None where it is in hand when the recording ends, or where it never comes to rest.
        vanished: Last time at which it was surely held, seconds, where it never comes to rest afterwards; else None.
        displacement: Largest distance from its rest, metres.
    """

    track: ObjectTrack
    pick: Departure | None
    put: Departure | None
    vanished: float | None
    displacement: float


def find_holdings(recording: Recording, rule: InHandRule) -> list[Holding]:
    """Every holding of every movable object by the wearer or by somebody else, objects in the recording's order.

    Slides shorter than ``rule.smallest_displacement`` are nudges and left out. Without a stream of the rule's contact
    point on the wearer's hands nothing can be said, and nothing is found.

    Raises:
        UsageError: for a rule about surfaces where no object has one.
    """
    if rule.target == "surface" and all(track.surface is None for track in recording.objects):
        lacks = "the in-hand rule measures distances to the objects' surfaces, and the recording was read without them"
        raise UsageError(f"{recording.recording_id}: {lacks}. Add `--option meshes=true`.")
    hands = contact_streams(recording, rule)
    if not recording.hand_streams(rule.contact):
        return []
    found: list[Holding] = []
    for track in recording.objects:
        if track.movable and np.count_nonzero(track.valid) >= 2:
            # A cheap upper bound of how far the centre of the box can have moved: twice the half diagonal of a cube
            # around the first row. Two orientations whose quaternions are d apart differ by an angle of at most pi d.
            spans = []
            for rows in (track.position[track.valid], track.rotation[track.valid]):
                spans.append(2 * float(np.sqrt(rows.shape[1]) * np.abs(rows - rows[0]).max()))
            lever = float(np.linalg.norm((track.box_min + track.box_max) / 2))
            if spans[0] + np.pi * spans[1] * lever >= rule.smallest_displacement:
                found.extend(_holdings_of(track, hands, rule))
    return found


def _holdings_of(track: ObjectTrack, hands: tuple[HandStream, ...], rule: InHandRule) -> list[Holding]:
    times, position, rotation = (column[track.valid] for column in (track.times, track.position, track.rotation))
    centre = position + Rotation.from_quat(rotation, scalar_first=True).apply((track.box_min + track.box_max) / 2)
    # Distance covered within a centred window over its length, m/s; at the ends the window is cut. The chord, not the
    # path: noise of the samples does not add up.
    before = np.maximum(times - rule.moving_window / 2, times[0])
    after = np.minimum(times + rule.moving_window / 2, times[-1])
    chord = interpolate(times, centre, after) - interpolate(times, centre, before)
    speed = np.linalg.norm(chord, axis=1) / (after - before)
    still = speed < rule.moving_speed / 2
    resting = rests(times, centre, still, 2 * rule.rest_tolerance)
    close = np.zeros(len(times), dtype=bool)
    near = np.zeros(len(times), dtype=bool)
    for hand in hands:
        distance = contact_distance(hand, track, rule, times, position, rotation)
        close |= close_to(distance, times, resting, rule.distance)
        near |= close_to(distance, times, resting, _STAYS_WITHIN * rule.distance)
    staying = near | ~still  # what never came to rest was not put down
    lasting = {"minimum_duration": rule.minimum_duration, "join_gap": rule.join_gap}
    segments = held_segments(close & (speed > rule.moving_speed), staying, times, **lasting).tolist()
    # A put is a pick seen backwards in time, so one search serves both.
    n = len(times)
    samples = Track(times, centre, position, rotation, rule.moving_window)
    backwards = Track(-times[::-1], centre[::-1], position[::-1], rotation[::-1], rule.moving_window)
    found = []
    for number, (start, stop) in enumerate(segments):
        floor = segments[number - 1][1] if number else 0
        ceiling = segments[number + 1][0] if number + 1 < len(segments) else n
        tolerance = rule.rest_tolerance
        pick = find_departure(samples, still, start, stop, floor=floor, tolerance=tolerance)
        put = find_departure(backwards, still[::-1], n - stop, n - start, floor=n - ceiling, tolerance=tolerance)
        if put is not None:
            put = replace(put, time=-put.time, gap=(-put.gap[0], -put.gap[1]))
        # Largest distance of the held object from its rest, smoothed over three samples: one jump of the tracker must
        # not make a nudge look like a displacement.
        path = centre[start:stop]
        if len(path) >= 3:
            path = (path[:-2] + path[1:-1] + path[2:]) / 3
        rest = pick or put
        origin = path[0] if rest is None else rest.centre
        displacement = float(np.linalg.norm(path - origin, axis=1).max())
        if displacement < rule.smallest_displacement:
            continue
        held_after = bool(staying[stop:].all())
        vanished = float(times[stop - 1]) if put is None and not held_after else None
        ends = (None if staying[:start].all() else pick, None if held_after else put)
        first, last = (None if end is None else placed_in_gap(end, hands, rule.distance) for end in ends)
        found.append(Holding(track, first, last, vanished, displacement))
    return found
