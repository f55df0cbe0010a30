"""Do the streams of one recording share a clock, a unit and a world? Measured, not believed.

Streams that should move together are matched at every lag up to eight seconds: gaze against head, head against body,
tracked wrists against the body's, hands against what they carry. Lengths and angles are compared with people's. Source
of every threshold: docs/specification/curation.md#clocks-units-and-worlds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.curation.in_hand import runs
from prbench.curation.mending import SAME_PLACE, Numbers, mended, named_streams, rides
from prbench.diagnosis import Diagnosis
from prbench.errors import RecordingUnusable
from prbench.geometry.skeleton import WRISTS, Joint, bone_lengths, head_forward
from prbench.geometry.timelines import covered, interpolate
from prbench.recording import SIDES, Recording

RATE = 30.0  # Hz, of the common grid
_LONGEST = 6 * 3600.0  # seconds from the start that are looked at; a broken clock must not ask for all memory
_REACH = 3  # steps of the grid to either side over which speeds are taken: 0.2 s in all
_STEPS = np.arange(-240, 241)  # lags that are looked at: 8 s to either side
_NO_LAG = len(_STEPS) // 2
_LONGEST_STEP = 0.25  # seconds between samples that are joined: gaze at 10 Hz may miss a row
_ONE_PEAK = 21  # steps around the best lag in which the second best belongs to the same peak
_CLEAR = 0.7  # share of the best agreement that no other lag may reach
_SWAY = 31  # steps of the mean that is taken off speeds: walking at one speed says nothing about time
_MOST_ROWS = 6000  # instants of a turning head; more tell nothing new
_TURNING = 0.25  # radians a second from which on a head turns
_STEADY = 0.25  # radians a second within which a gaze rests on its place
_CARRIED = 0.2  # share of the highest speed of any object from which on an object is carried
_SHORTEST_CARRY = 12  # steps
_AT_PLACE = 0.15  # metres from an annotated place at which a wrist is there
# What is matched: agreement that a lag needs, seconds of movement (for places: events) that tell it, the natural lag
# (gaze turns before the face does), and the lag that says nothing (people annotate a moment too early or late).
_NEEDED = {
    "gaze in head": (0.12, 6.0, 0.0, 0.0),
    "gaze in world": (0.3, 6.0, -0.2, 0.0),
    "movement": (0.55, 3.0, 0.0, 0.0),
    "carrying": (0.5, 3.0, 0.0, 0.0),
    "places": (0.5, 8.0, 0.0, 0.5),
}
_TOLD_LAG = 0.2  # seconds
_GROSS_LAG = 0.5  # seconds: half of what a reach takes, as for files that end early
_FARTHEST_OFFSET = 0.6  # metres between one place as two streams see it: half of a large object, and some more
_WIDEST_GAZE = 45.0  # degrees from the forward axis of the head, in the median
_LEAST_UP = 0.5  # cosine between up in a body or head and up in the world, in the median
_LONGEST_STILL = 2.0  # seconds
_FACTORS = np.array([1.0, 1000.0, 100.0, 0.01, 0.001])  # that a wrong unit may multiply positions with
_TRUSTED = ("head", "body", "hands", "objects", "gaze")  # of two streams that differ the later one is said to be off
_UPRIGHT = (Joint.LEFT_KNEE, Joint.LEFT_ANKLE, Joint.SPINE1, Joint.SPINE2, Joint.SPINE3, Joint.NECK, Joint.HEAD)
_NO_OPTION = "No option mends it: write the file in the dataset's own axes and world."

_Rows = Float[np.ndarray, "_ 3"]
_Moving = tuple[_Rows, Bool[np.ndarray, " _"]]  # values at 30 Hz, and where they are known
_Curve = Float[np.ndarray, " _"]


@dataclass(frozen=True)
class Pair:
    """How well two streams that should move together do so.

    Attributes:
        kind: What was matched, such as ``movement``.
        one: Name of the first stream.
        other: Name of the second stream.
        lag: Seconds by which the first is late where they agree best, beyond what is natural.
        height: Agreement there; 1 for equal movements.
        second: Best agreement at any other lag.
        seconds: Time of movement that told it; number of events where places did.
        sure: True if the lag can be believed.
        offset: The first minus the second (3,) in the median, metres; None where nothing tells it.
    """

    kind: str
    one: str
    other: str
    lag: float
    height: float
    second: float
    seconds: float
    sure: bool
    offset: Float[np.ndarray, "3"] | None = None


@dataclass(frozen=True)
class Gridded:
    """Streams of one recording at 30 evenly spaced instants a second.

    Attributes:
        head: The glasses, else the head joint of the body; None without either.
        joints: Head and wrists of the body by name; empty without a body.
        hands: Tracked hands by side.
        carries: Stretches in which an object moves: positions, velocities, and where on the grid they lie.
        facing: Rotations of the glasses; None without them.
        turn: Angular velocity (n, 3) of the glasses in their own axes, radians a second; None without glasses.
        turning: Rows in which they turn.
        local: Gaze in the axes of the glasses; None without glasses or gaze.
    """

    recording: Recording
    grid: Float[np.ndarray, " n"]
    head: _Moving | None
    joints: Mapping[str, _Moving]
    hands: Mapping[str, _Moving]
    carries: tuple[tuple[_Rows, _Rows, slice], ...]
    facing: Rotation | None
    turn: _Rows | None
    turning: Int[np.ndarray, " k"]
    local: _Moving | None


def examine_streams(recording: Recording, trusted: Collection[str] = ()) -> tuple[Diagnosis, ...]:
    """Say which streams of a recording have another clock, unit or world than the others, or do not move.

    A fault that explains others comes alone: what is looked at later leaves out the streams that have one.

    Args:
        recording: What a reader yields, mended as the user asks (:mod:`prbench.curation.mending`).
        trusted: Streams that the user vouches for: their findings are told, and never certain.

    Returns:
        Findings, certain ones first: with those, events would be wrong, and the recording must not be curated.
    """
    start, end = recording.span
    grid = np.arange(start, min(end, start + _LONGEST), 1 / RATE)
    if len(grid) <= 2 * _REACH:
        return ()
    streams = gridded(recording, grid)
    pairs = stream_pairs(streams)
    stuck = _stuck(streams)
    found = _wrong_measures(streams, pairs, {name: each for name, each in stuck.items() if each.kind == "stuck"})
    # What was measured from a stream with a finding tells nothing.
    blamed = set(found)
    if ("head" if streams.turn is not None else "body") in blamed:
        blamed |= {"gaze", "hands"} if recording.hands_from_glasses else {"gaze"}
    pairs = [pair for pair in pairs if not {pair.one, pair.other} & blamed]
    sure = [pair for pair in pairs if pair.sure]
    for name, (lag,) in _outliers([(pair.one, pair.other, np.array([pair.lag])) for pair in sure], _TOLD_LAG).items():
        told = max((pair for pair in sure if name in (pair.one, pair.other)), key=lambda pair: abs(pair.lag))
        said = f"{name}: {abs(lag):.2f} s {'late' if lag > 0 else 'early'}, expected within {_TOLD_LAG} s: so it agrees"
        said += f" best ({told.one} with {told.other}: {told.height:.2f}, at any other lag at most {told.second:.2f},"
        said += f" over {told.seconds:.0f} {'events' if told.kind == 'places' else 's of movement'})."
        remedy = _options("shift", name, f"{-lag:.2f}")
        certain = bool(abs(lag) >= _GROSS_LAG)
        found[name] = Diagnosis("clock", certain, said, "Its times are those of another clock.", remedy)
    left = [pair for pair in pairs if not {pair.one, pair.other} & found.keys()]
    apart = [(pair.one, pair.other, pair.offset) for pair in left if pair.offset is not None]
    for name, (x, y, z) in _outliers(apart, _FARTHEST_OFFSET).items():
        said = f"{name}: {x:+.2f}, {y:+.2f}, {z:+.2f} m (x, up, z) from where other streams see the same place,"
        said += f" expected within {_FARTHEST_OFFSET} m."
        found[name] = Diagnosis("place", True, said, "Its world has other axes, another origin or floor.", _NO_OPTION)
    faults = (stuck | found).items()
    judged = [replace(fault, certain=fault.certain and name not in trusted) for name, fault in faults]
    return tuple(sorted(judged, key=lambda fault: not fault.certain))


def sound(
    recording: Recording, shift: Numbers = (), scale: Numbers = (), *, unused: Collection[str] = ()
) -> tuple[Recording, tuple[str, ...]]:
    """Return a recording, mended as the user asks, and what :func:`examine_streams` has to tell of it.

    Args:
        recording: What a reader yields.
        shift: See :func:`prbench.curation.mending.mended`; a stream that is named is vouched for.
        scale: See there.
        unused: Streams that nothing is made of: their findings are told, and refuse nothing.

    Raises:
        RecordingUnusable: if a stream is certainly wrong: what is made of it would be, too.
    """
    recording = mended(recording, shift, scale)
    findings = examine_streams(recording, named_streams(recording.recording_id, shift, scale).union(unused))
    if certain := [str(each) for each in findings if each.certain]:
        raise RecordingUnusable(" ".join(certain))
    return recording, tuple(map(str, findings))


def gridded(recording: Recording, grid: Float[np.ndarray, " n"]) -> Gridded:
    """Put the streams of a recording on evenly spaced instants, 30 a second."""
    body = recording.body
    glasses = recording.head
    gaze = recording.gaze
    joints = {}
    if body is not None:
        for name, joint in zip(("head", *SIDES), (Joint.HEAD, *WRISTS), strict=True):
            joints[name] = _on_grid(body.times, body.joints[:, joint], body.valid, grid)
    hands = {}
    # One stream of each hand: the last one, that of the wrist where it is tracked.
    for hand in sorted(recording.hands, key=lambda hand: hand.contact == "wrist"):
        hands[hand.side] = _on_grid(hand.times, hand.points.mean(axis=1, dtype=np.float64), hand.valid, grid)
    head = joints.get("head")
    facing = turn = local = None
    turning = np.zeros(0, dtype=int)
    if glasses.valid.any():
        head = _on_grid(glasses.times, glasses.position, glasses.valid, grid)
        facing = Rotation.from_quat(glasses.pose_at(grid)[1], scalar_first=True)
        steps = (facing[: -2 * _REACH].inv() * facing[2 * _REACH :]).as_rotvec() * (RATE / (2 * _REACH))
        turn = np.pad(steps, ((_REACH, _REACH), (0, 0)))
        turning = np.flatnonzero(head[1] & (np.linalg.norm(turn, axis=1) > _TURNING))
        turning = turning[:: 1 + len(turning) // _MOST_ROWS]
        if gaze.valid.any():
            eyes = Rotation.from_quat(glasses.pose_at(gaze.times)[1], scalar_first=True).inv().apply(gaze.direction)
            local = _on_grid(gaze.times, eyes, gaze.valid, grid)
    carries = tuple(_carries(recording, grid))
    return Gridded(recording, grid, head, joints, hands, carries, facing, turn, turning, local)


def _on_grid(times: np.ndarray, points: np.ndarray, valid: np.ndarray, grid: np.ndarray) -> _Moving:
    if not valid.any():
        return np.zeros((len(grid), 3)), np.zeros(len(grid), dtype=bool)
    return interpolate(times[valid], points[valid], grid), covered(times, valid, grid, max_gap=_LONGEST_STEP)


def _speeds(moving: _Moving) -> _Moving:
    """Return velocities over 0.2 s, a second; zero where unknown."""
    points, known = moving
    both = np.zeros_like(known)
    both[_REACH:-_REACH] = known[2 * _REACH :] & known[: -2 * _REACH]
    speeds = np.zeros_like(points)
    speeds[_REACH:-_REACH] = (points[2 * _REACH :] - points[: -2 * _REACH]) * (RATE / (2 * _REACH))
    return np.where(both[:, None], speeds, 0.0), both


def _matched(one: _Moving, other: _Moving) -> _Curve:
    """Return the correlation of two velocities at every lag, normalised by what of both is known there."""
    size = 1 << int(np.ceil(np.log2(len(one[0]) + len(_STEPS))))
    power = [(speeds**2).sum(axis=1) for speeds, _ in (one, other)]
    first = np.fft.rfft(np.column_stack([one[0], power[0], one[1]]), size, axis=0)
    second = np.fft.rfft(np.column_stack([other[0], other[1], power[1]]), size, axis=0)
    products = np.fft.irfft(first * second.conj(), size, axis=0)[_STEPS]
    shared = np.sqrt(np.maximum(products[:, 3] * products[:, 4], 0.0))
    # Where little of the movement overlaps, a few samples would agree by chance.
    least = 0.2 * np.sqrt(power[0].sum() * power[1].sum())
    return products[:, :3].sum(axis=1) / np.maximum(shared, least + 1e-12)


def _pair(one: str, other: str, kind: str, curve: _Curve, seconds: float, offset: np.ndarray | None = None) -> Pair:
    """Judge the best lag of a curve, which a parabola through the peak tells to parts of a step."""
    least, shortest, natural, slack = _NEEDED[kind]
    top = int(np.argmax(curve[1:-1])) + 1
    before, height, after = curve[top - 1 : top + 2].tolist()
    second = float(np.max(curve[np.abs(_STEPS - _STEPS[top]) > _ONE_PEAK]))
    part = float(np.clip(0.5 * (before - after) / min(before - 2 * height + after, -1e-12), -0.5, 0.5))
    lag = (float(_STEPS[top]) + part) / RATE - natural
    sure = height >= least and second <= _CLEAR * height and seconds >= shortest and abs(lag) >= slack
    return Pair(kind, one, other, lag, height, second, seconds, sure, offset)


def stream_pairs(streams: Gridded) -> list[Pair]:
    """Match every two streams that should move together."""
    pairs = []
    if streams.turn is not None and streams.joints and streams.head is not None:
        pairs.append(_moving_pair("head", "body", streams.head, streams.joints["head"]))
    for side, hand in streams.hands.items():
        if streams.joints:
            seen = _moving_pair("hands", "body", hand, streams.joints[side])
            # In one of the two axes the own movement of a head on another clock is in one of the streams alone.
            if streams.recording.hands_from_glasses and streams.facing is not None and streams.head is not None:
                points, known = streams.head
                turned = streams.facing.inv()
                both = (hand, streams.joints[side])
                local = [(turned.apply(places - points), known & tracked) for places, tracked in both]
                beside = replace(_moving_pair("hands", "body", *local), offset=seen.offset)
                seen = max(seen, beside, key=lambda pair: pair.height)
            pairs.append(seen)
    found = (_gaze_pair(streams), _carrying_pair(streams), _placing_pair(streams))
    return pairs + [pair for pair in found if pair is not None]


def _moving_pair(one: str, other: str, first: _Moving, second: _Moving) -> Pair:
    window = np.ones(min(_SWAY, len(first[1])))
    swaying = []
    for speeds, known in (_speeds(first), _speeds(second)):
        count = np.maximum(np.convolve(known.astype(float), window, "same"), 1.0)
        mean = np.stack([np.convolve(column, window, "same") / count for column in speeds.T], axis=1)
        swaying.append((np.where(known[:, None], speeds - mean, 0.0), known))
    both = first[1] & second[1]
    moving = swaying[0][1] & swaying[1][1]
    speed = np.linalg.norm(swaying[1][0], axis=1)
    seconds = float((moving & (speed > 0.2 * np.quantile(speed, 0.98))).sum() / RATE)
    offset = np.median((first[0] - second[0])[both], axis=0) if both.any() else None
    return _pair(one, other, "movement", _matched(*swaying), seconds, offset)


def _gaze_pair(streams: Gridded) -> Pair | None:
    """Match gaze with the head: a gaze that turns with it rests on its place only where eyes turn against it.

    A gaze that was not made of these poses of the head is matched as any other stream, or with the face of the body.
    """
    recording = streams.recording
    gaze = recording.gaze
    body = recording.body
    if streams.head is None or not gaze.valid.any():
        return None
    origin = _on_grid(gaze.times, gaze.origin, gaze.valid, streams.grid)
    if streams.turn is not None and streams.local is not None:
        if not rides(gaze, recording.head):
            return _moving_pair("gaze", "head", origin, streams.head)
        seconds = float(streams.local[1][streams.turning].sum() / RATE)
        return _pair("gaze", "head", "gaze in head", _steadiness(streams, streams.local), seconds)
    assert body is not None, "without glasses the head is the body's"
    apart = np.linalg.norm(origin[0] - streams.head[0], axis=1)[origin[1]]
    if np.median(np.append(apart, 0.0)) > SAME_PLACE:
        return _moving_pair("gaze", "body", origin, streams.head)
    forward, _ = head_forward(body.joints, recording.head_tilt_deg)
    turns = []
    for stream, directions in ((gaze, gaze.direction), (body, forward)):
        looked = _on_grid(stream.times, directions, stream.valid, streams.grid)
        change, known = _speeds(looked)
        turns.append((np.cross(looked[0], change), known))
    seconds = float((np.linalg.norm(turns[1][0], axis=1) > _TURNING).sum() / RATE)
    return _pair("gaze", "body", "gaze in world", _matched(*turns), seconds)


def _steadiness(streams: Gridded, local: _Moving, steps: np.ndarray = _STEPS) -> _Curve:
    """Return the share of a turning head's time in which gaze keeps its place, for eyes that are late by some steps.

    Rolling about the gaze moves no gaze, so only turns about x and y count.
    """
    assert streams.turn is not None, "asked of recordings with glasses"
    change, known = _speeds(local)
    eye = np.cross(local[0], change)
    curve = np.zeros(len(steps))
    for index, step in enumerate(steps):
        rows = streams.turning
        rows = rows[(rows + step >= 0) & (rows + step < len(known))]
        rows = rows[known[rows + step]]
        drift = streams.turn[rows, :2] + eye[rows + step, :2]
        steady = np.exp(-(drift**2).sum(axis=1) / (2 * _STEADY**2))
        # Few instants would agree by chance.
        curve[index] = steady.sum() / max(len(rows), 0.4 * len(streams.turning), 1)
    return curve


def _carries(recording: Recording, grid: np.ndarray) -> Iterator[tuple[_Rows, _Rows, slice]]:
    """Yield positions and velocities of each stretch in which an object moves, and where on the grid it lies.

    Fast is what is fast beside the fastest object, so that no unit matters.
    """
    movable = [track for track in recording.objects if track.movable and track.valid.sum() > _SHORTEST_CARRY]
    placed = [_on_grid(track.times, track.position, track.valid, grid) for track in movable]
    moving = [_speeds(each)[0] for each in placed]
    fast = [np.linalg.norm(speeds, axis=1) for speeds in moving]
    # A tracker that jumps once is faster than any hand.
    highest = max((float(np.quantile(each, 0.995)) for each in fast), default=0.0)
    for (points, _), speeds, speed in zip(placed, moving, fast, strict=True):
        for start, stop in runs(speed > max(_CARRIED * highest, 1e-9)):
            if stop - start >= _SHORTEST_CARRY:
                part = slice(max(start - 2 * _REACH, 0), min(stop + 2 * _REACH, len(grid)))
                yield points[part], speeds[part], part


def _carrying_pair(streams: Gridded) -> Pair | None:
    """Match objects with the hand that carries each of them best, stretch by stretch."""
    hands = []
    for speeds, known in map(_speeds, streams.hands.values()):
        hands.append((np.pad(speeds, ((_NO_LAG, _NO_LAG), (0, 0))), np.pad(known.astype(float), _NO_LAG)))
    if not streams.carries or not hands:
        return None
    agreed = np.zeros(len(_STEPS))
    seen = np.zeros(len(_STEPS))
    paced = 0.0
    for _, speeds, part in streams.carries:
        length = len(speeds)
        around = slice(part.start, part.stop + 2 * _NO_LAG)
        alike = np.zeros((len(hands), len(_STEPS)))
        known = np.zeros((len(hands), len(_STEPS)), dtype=bool)
        for row, (fast, its_known) in enumerate(hands):
            near = fast[around]
            together = sum(np.correlate(near[:, axis], speeds[:, axis], "valid") for axis in range(3))
            power = np.convolve((near**2).sum(axis=1), np.ones(length), "valid")
            # A resting hand agrees by chance; its own movements say what little is, in whatever unit objects are.
            floor = 0.05 * length * max(np.quantile((fast**2).sum(axis=1), 0.9), 1e-9)
            known[row] = np.convolve(its_known[around], np.ones(length), "valid") > 0.8 * length
            alike[row] = together / np.sqrt(np.maximum(power, floor) * (speeds**2).sum())
        agreed += length * np.where(known, alike, 0.0).max(axis=0)
        seen += length * known.any(axis=0)
        own = slice(part.start + _NO_LAG, part.stop + _NO_LAG)
        paced += length * max(_correlation(speeds, fast[own]) for fast, _ in hands)
    # An object that is late meets the hand of before. A stretch without a hand tells nothing.
    total = sum(len(speeds) for _, speeds, _ in streams.carries)
    curve = (agreed / np.maximum(seen, total / 2))[::-1]
    # What no seen hand moves, but noise or another person, lies anywhere. Exchanged axes leave the pace alike.
    carried = max(curve.max(), paced / total) >= _NEEDED["carrying"][0]
    apart = _from_hands(streams, int(_STEPS[np.argmax(curve)])) if carried else None
    offset = None if apart is None else np.median(apart, axis=0)
    return _pair("objects", "hands", "carrying", curve, float(seen[_NO_LAG]) / RATE, offset)


def _correlation(one: _Rows, other: _Rows) -> float:
    """Return the correlation of the lengths of two sets of velocities."""
    first, second = (np.linalg.norm(each, axis=1) for each in (one, other))
    first, second = first - first.mean(), second - second.mean()
    return float(first @ second / max(np.sqrt((first @ first) * (second @ second)), 1e-12))


def _from_hands(streams: Gridded, step: int, factor: float = 1.0) -> _Rows | None:
    """Return how far carried objects are from the nearer hand, metres; None where no hand is known.

    Args:
        streams: The streams.
        step: Steps of the grid by which objects are late.
        factor: Divisor of their positions.
    """
    found = []
    for points, _, part in streams.carries:
        rows = np.arange(part.start, part.stop) - step
        rows = rows[(rows >= 0) & (rows < len(streams.grid))]
        near = []
        for place, known in streams.hands.values():
            seen = rows[known[rows]]
            if len(seen):
                near.append(points[seen + step - part.start] / factor - place[seen])
        if near:
            found.append(min(near, key=lambda apart: float(np.linalg.norm(apart, axis=1).mean())))
    return np.concatenate(found) if found else None


def _placing_pair(streams: Gridded) -> Pair | None:
    """Match annotated events of a dataset without tracks with the wrists, which are at the place at that time."""
    events = [event for event in streams.recording.annotated_events if event.location is not None]
    if streams.recording.objects or not events or not streams.hands or not streams.recording.hands_from_glasses:
        return None
    rows = np.array([round((event.event_time - streams.grid[0]) * RATE) for event in events])[:, None] - _STEPS
    inside = (rows >= 0) & (rows < len(streams.grid))
    rows = np.clip(rows, 0, len(streams.grid) - 1)
    places = np.stack([event.location for event in events if event.location is not None])[:, None]
    there = np.zeros(rows.shape)
    seen = np.zeros(rows.shape, dtype=bool)
    for points, known in streams.hands.values():
        apart = np.linalg.norm(points[rows] - places, axis=2)
        there = np.maximum(there, np.where(inside & known[rows], np.exp(-(apart**2) / (2 * _AT_PLACE**2)), 0.0))
        seen |= inside & known[rows]
    curve = there.sum(axis=0) / np.maximum(seen.sum(axis=0), 0.3 * len(events))
    return _pair("objects", "hands", "places", curve, float(seen[:, _NO_LAG].sum()))


def _outliers(edges: Sequence[tuple[str, str, np.ndarray]], tolerance: float) -> dict[str, np.ndarray]:
    """Return the fewest streams that explain all differences, and by how much each of them is off.

    Args:
        edges: Two streams and the difference of the first from the second.
        tolerance: Length of a difference that is none.
    """
    plain = [(one, other, off * (np.linalg.norm(off) > tolerance)) for one, other, off in edges]
    left = [name for name in _TRUSTED if any(name in edge[:2] for edge in plain)]
    moved: dict[str, np.ndarray] = {}
    while left:
        group = _offsets_from(left[0], plain)
        # Whichever stream is believed, others are off by what the edges say; of two that explain it the trusted one.
        explained = [_offsets_from(name, plain) for name in left if name in group]
        counted = [{name: off for name, off in each.items() if np.linalg.norm(off) > tolerance} for each in explained]
        moved |= min(counted, key=len)
        left = [name for name in left if name not in group]
    return moved


def _offsets_from(anchor: str, edges: Sequence[tuple[str, str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return how far every stream that edges lead to is off if ``anchor`` is right."""
    off = {anchor: np.zeros_like(edges[0][2])}
    for _ in edges:  # the longest way takes every edge once
        for one, other, difference in edges:
            if other in off and one not in off:
                off[one] = off[other] + difference
            elif one in off and other not in off:
                off[other] = off[one] - difference
    return off


def _wrong_measures(streams: Gridded, pairs: Sequence[Pair], found: Mapping[str, Diagnosis]) -> dict[str, Diagnosis]:
    """Compare lengths and directions with people's; lengths also in other units than the reader took."""
    wrong = dict(found)
    for stream, reference, measure, values, low, high in _measures(streams, pairs):
        fits = (values >= low) & (values <= high)
        if fits[0] or stream in wrong or reference in wrong:
            continue
        said = f"{stream}: {measure} is {values[0]:.3g}, expected {low:g} to {high:g}."
        if len(values) == 1:
            wrong[stream] = Diagnosis("axes", True, said, "Its axes are exchanged, mirrored or turned.", _NO_OPTION)
        elif fits.any():
            # Of several units that fit the one in which the length is the most usual.
            unusual = np.abs(np.log(np.maximum(values, 1e-9) / np.sqrt(low * high)))
            factor = _FACTORS[int(np.argmin(np.where(fits, unusual, np.inf)))]
            cause = f"Its positions are {factor:g} times what they should be: another unit than the dataset's."
            wrong[stream] = Diagnosis("unit", True, said, cause, _options("scale", stream, f"{1 / factor:g}"))
    return wrong


def _options(option: str, stream: str, number: str) -> str:
    """Return what mends a stream; glasses carry their camera."""
    names = ("head", "camera") if stream == "head" else (stream,)
    return "Mend it with " + " ".join(f"--{option} {name}={number}" for name in names) + "."


def _measures(streams: Gridded, pairs: Sequence[Pair]) -> Iterator[tuple[str, str, str, np.ndarray, float, float]]:
    """Yield a stream, the one it is measured from, the measure, its value, people's least and largest.

    Of lengths there are more values: divided by each of the factors that a wrong unit multiplies positions with.
    """
    recording = streams.recording
    body = recording.body
    head = streams.head
    face = "body" if streams.turn is None else "head"
    ahead = np.ones(0)

    def away(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
        return np.array([np.median(np.linalg.norm(points / factor - centre, axis=1)) for factor in _FACTORS])

    if body is not None and body.valid.any():
        joints = body.joints[body.valid]
        bones = np.median(bone_lengths(joints), axis=0)
        upright = bones[[joint - 1 for joint in _UPRIGHT]].sum()  # bones stand in the order of their lower ends
        yield "body", "body", "ankle to head along the bones (m)", upright / _FACTORS, 0.9, 2.4
        up = np.median(joints[:, Joint.HEAD] - joints[:, Joint.LEFT_ANKLE], axis=0)
        yield "body", "body", "its up along Y (cosine)", up[1:2] / np.linalg.norm(up), _LEAST_UP, 1.01
    if streams.turn is not None and streams.facing is not None and head is not None and head[1].any():
        speeds, known = _speeds(head)
        rows = streams.turning[known[streams.turning]]
        if len(rows) > _NEEDED["movement"][1] * RATE:
            lever = np.linalg.norm(speeds[rows], axis=1) / np.linalg.norm(streams.turn[rows], axis=1)
            yield "head", "head", "its way for a radian of turning (m)", np.median(lever) / _FACTORS, 0.02, 5.0
        up = np.median(streams.facing.apply((0.0, 1.0, 0.0))[head[1]], axis=0, keepdims=True)
        yield "head", "head", "its up along Y (cosine)", up[0, 1:2], _LEAST_UP, 1.01
    for place, known in streams.hands.values():
        both = known if head is None else known & head[1]
        if head is not None and both.any():
            # Wrists that glasses measured lie beside the head in any unit.
            beside = head[0][both] * recording.hands_from_glasses
            distances = away(place[both] - beside, head[0][both] - beside)
            yield "hands", face, "the distance of a wrist from the head (m)", distances, 0.1, 1.2
    for pair in pairs:
        if pair.kind == "carrying" and pair.offset is not None:
            late = round(pair.lag * RATE) if pair.sure else 0
            carried = [_from_hands(streams, late, factor) for factor in _FACTORS]
            distances = [np.median(np.linalg.norm(apart, axis=1)) for apart in carried if apart is not None]
            measure = "the distance of carried ones from the nearer hand (m)"
            yield "objects", "hands", measure, np.array(distances), 0.005, _FARTHEST_OFFSET
    places = [event.location for event in recording.annotated_events if event.location is not None]
    if places and head is not None and head[1].any() and not recording.objects:
        measure = "the distance of their places from the middle of the way (m)"
        yield "objects", "head", measure, away(np.stack(places), np.median(head[0][head[1]], axis=0)), 0.2, 15.0
    gaze = recording.gaze
    if streams.local is not None:
        ahead = streams.local[0][streams.local[1], 2]
    elif body is not None and body.valid.any():
        forward, _ = head_forward(body.joints[body.valid], recording.head_tilt_deg)
        seen = gaze.times[gaze.valid]
        ahead = (interpolate(body.times[body.valid], forward, seen) * gaze.direction[gaze.valid]).sum(axis=1)
    is_late = any(pair.sure and abs(pair.lag) > _TOLD_LAG for pair in pairs if pair.one == "gaze")
    if len(ahead) < _NEEDED["gaze in head"][1] * RATE or is_late:
        return
    if streams.local is not None:
        points, known = streams.local
        mirrored = (points, points * [-1.0, 1.0, 1.0], points * [1.0, -1.0, 1.0], points[:, [1, 0, 2]])
        own, *others = (float(_steadiness(streams, (each, known), np.zeros(1, dtype=int))[0]) for each in mirrored)
        if max(others) >= _NEEDED["gaze in head"][0]:
            measure = "how often it rests on its place, beside mirrored or exchanged axes"
            yield "gaze", face, measure, np.array([own / max(others)]), 0.4, np.inf
    angle = np.rad2deg(np.arccos(np.clip(np.median(ahead), -1.0, 1.0)))
    yield "gaze", face, "its angle to where the head faces (degrees)", np.array([angle]), 0.0, _WIDEST_GAZE


def _stuck(streams: Gridded) -> dict[str, Diagnosis]:
    """Look for streams that stand still to the last digit, which no person does."""
    head = streams.head if streams.turn is not None else None
    parts: list[tuple[str, _Moving | None]] = [("head", head), ("gaze", streams.local)]
    parts += [("body", each) for each in streams.joints.values()]
    parts += [("hands", each) for each in streams.hands.values()]
    found = {}
    for name, moving in parts:
        points, known = moving or (np.zeros((2, 3)), np.zeros(2, dtype=bool))
        still = runs((np.abs(np.diff(points, axis=0)).max(axis=1) < 1e-9) & known[1:])
        lasting = (still[:, 1] - still[:, 0]) / RATE
        frozen = float(lasting[lasting >= _LONGEST_STILL].sum())
        share = frozen * RATE / max(int(known.sum()), 1)
        if frozen:
            said = f"{name}: does not move at all for {frozen:.1f} s ({share:.0%} of its time), expected at most"
            said += f" {_LONGEST_STILL:g} s at a time."
            kind = "stuck" if share > 0.5 else "still"
            # A head or a hand may be held still by whatever carries it; eyes and a whole body never are.
            certain = kind == "stuck" and name in ("gaze", "body")
            cause = "The sensor or its file repeats one value."
            found[name] = Diagnosis(kind, certain, said, cause, "Copy or record it again.")
    return found
