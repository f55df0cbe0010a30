"""Do the streams of one recording share a clock, a unit and a world? Measured, not believed.

Streams that should move together are matched at every lag up to eight seconds: gaze against head, head against body,
tracked wrists against the body's, hands against what they carry. Lengths and angles are compared with people's. Source
of every threshold: docs/specification/curation.md#clocks-units-and-worlds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from prbench.curation.in_hand import runs
from prbench.curation.mending import rides
from prbench.diagnosis import Diagnosis
from prbench.geometry.skeleton import WRISTS, Joint, bone_lengths, head_forward
from prbench.geometry.timelines import covered, interpolate
from prbench.recording import Recording
from prbench.recording.streams import SIDES

RATE = 30.0  # Hz, of the common grid
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
_LEAD = 0.2  # seconds by which gaze turns before the face does
# What is matched: agreement that a lag needs, seconds of movement (for places: events) that tell it, and seconds of lag
# that say nothing: people annotate a moment before or after it happens.
_NEEDED = {
    "gaze in head": (0.12, 6.0, 0.0),
    "gaze in world": (0.3, 6.0, 0.0),
    "movement": (0.55, 3.0, 0.0),
    "carrying": (0.5, 3.0, 0.0),
    "places": (0.5, 8.0, 0.5),
}
_NO_PEAK = 0.85  # share of the best agreement which, if reached elsewhere, says that no lag agrees
_TELLING = 10.0  # seconds of movement after which that is a finding of its own
_TURNED = 0.75  # agreement of two streams in other axes that tells that one of them has these
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
_Found = Mapping[str, Diagnosis]


@dataclass(frozen=True)
class Pair:
    """How well two streams that should move together do so.

    Attributes:
        one: Name of the first stream.
        other: Name of the second stream.
        lag: Seconds by which the first is late where they agree best, beyond what is natural.
        height: Agreement there; 1 for equal movements.
        second: Best agreement at any other lag.
        seconds: Time of movement that told it; number of events where places did.
        sure: True if the lag can be believed.
        strange: True for a gaze that rests on no place at any lag, though the head turns for long.
        offset: The first minus the second (3,) in the median, metres; None where nothing tells it.
        turned: Axes (3, 3) of the first in which it would agree with the second, where it does not in its own.
    """

    one: str
    other: str
    lag: float
    height: float
    second: float
    seconds: float
    sure: bool
    strange: bool
    offset: Float[np.ndarray, "3"] | None = None
    turned: Float[np.ndarray, "3 3"] | None = None


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


def examine_streams(recording: Recording) -> tuple[Diagnosis, ...]:
    """Say which streams of a recording have another clock, unit or world than the others, or do not move.

    A fault that explains others comes alone: what is looked at later leaves out the streams that have one.

    Args:
        recording: What a reader yields, mended as the user asks (:mod:`prbench.curation.mending`).

    Returns:
        Findings, certain ones first: with those, events would be wrong, and the recording must not be curated.
    """
    grid = np.arange(recording.span[0], recording.span[1], 1 / RATE)
    if len(grid) <= 2 * _REACH:
        return ()
    streams = gridded(recording, grid)
    pairs = stream_pairs(streams)
    found = _stuck(streams)
    found |= _wrong_units(streams, pairs, found)
    found |= _wrong_axes(streams, pairs, found)
    sure = [pair for pair in _unblamed(streams, pairs, found) if pair.sure]
    for name, off in _outliers([(pair.one, pair.other, np.array([pair.lag])) for pair in sure], _TOLD_LAG).items():
        told = max((pair for pair in sure if name in (pair.one, pair.other)), key=lambda pair: abs(pair.lag))
        found[name] = _wrong_clock(name, float(off[0]), told)
    left = _unblamed(streams, pairs, found)
    apart = [(pair.one, pair.other, pair.offset) for pair in left if pair.offset is not None]
    for name, (x, y, z) in _outliers(apart, _FARTHEST_OFFSET).items():
        said = f"{name}: {x:+.2f}, {y:+.2f}, {z:+.2f} m (x, up, z) from where other streams see the same place,"
        said += f" expected within {_FARTHEST_OFFSET} m."
        found[name] = Diagnosis("place", True, said, "Its world has another origin or floor.", _NO_OPTION)
    for pair in _unblamed(streams, left, found):
        if pair.strange:
            said = f"gaze: rests on no place while the head turns, at any lag ({pair.height:.2f} at best over"
            said += f" {pair.seconds:.0f} s)."
            cause = "It may belong to another recording, or have mirrored axes."
            found["gaze"] = Diagnosis("axes", False, said, cause, _NO_OPTION)
    return tuple(sorted(found.values(), key=lambda each: not each.certain))


def _unblamed(streams: Gridded, pairs: Sequence[Pair], found: _Found) -> list[Pair]:
    blamed = _blamed(streams, found)
    return [pair for pair in pairs if not {pair.one, pair.other} & blamed]


def _blamed(streams: Gridded, found: _Found) -> set[str]:
    """Return streams with a certain fault, and those that were measured from one of them."""
    names = {name for name, each in found.items() if each.certain}
    if ("head" if streams.turn is not None else "body") in names:
        names |= {"gaze", *(["hands"] if streams.recording.hands_from_glasses else [])}
    return names


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
    if len(glasses.times):
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
    known = covered(times, valid, grid, max_gap=_LONGEST_STEP)
    return interpolate(times[valid], points[valid], grid), known


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


def _turned(one: _Rows, other: _Rows) -> tuple[float, Float[np.ndarray, "3 3"]]:
    """Return the agreement of two velocities in the best axes for it, and these axes of the first."""
    left, strength, right = np.linalg.svd(other.T @ one)
    power = np.sqrt((one**2).sum() * (other**2).sum())
    return float(strength.sum() / max(power, 1e-12)), left @ right


def _pair(
    names: tuple[str, str],
    kind: str,
    curve: _Curve,
    seconds: float,
    *,
    offset: np.ndarray | None = None,
    turned: tuple[float, np.ndarray] | None = None,
    natural: float = 0.0,
) -> Pair:
    """Judge the best lag of a curve, which a parabola through the peak tells to parts of a step."""
    top = int(np.argmax(curve))
    height = float(curve[top])
    second = float(np.max(curve[np.abs(_STEPS - _STEPS[top]) > _ONE_PEAK]))
    least, shortest, slack = _NEEDED[kind]
    inside = 0 < top < len(curve) - 1
    lag = float(_STEPS[top]) / RATE
    if inside:
        before, after = curve[[top - 1, top + 1]]
        lag += float(np.clip(0.5 * (before - after) / min(before - 2 * height + after, -1e-12), -0.5, 0.5)) / RATE
    lag -= natural
    sure = inside and height >= least and second <= _CLEAR * height and seconds >= shortest and abs(lag) >= slack
    strange = kind == "gaze in head" and second >= _NO_PEAK * height and seconds >= _TELLING
    axes = None
    if turned is not None and not sure and seconds >= 2 * shortest and turned[0] >= _TURNED:
        axes = turned[1] if (np.abs(turned[1] - np.eye(3)) > 0.5).any() else None
    return Pair(*names, lag, height, second, seconds, sure, strange, offset, axes)


def stream_pairs(streams: Gridded) -> list[Pair]:
    """Match every two streams that should move together."""
    pairs = []
    if streams.turn is not None and streams.joints and streams.head is not None:
        pairs.append(_moving_pair("head", "body", streams.head, streams.joints["head"]))
    for side, hand in streams.hands.items():
        if streams.joints:
            seen = _moving_pair("hands", "body", hand, streams.joints[side])
            # In one of the two axes the own movement of a head on another clock is in one of the streams alone.
            local = [_from_glasses(streams, each) for each in (hand, streams.joints[side])]
            beside = replace(_moving_pair("hands", "body", *local), offset=seen.offset)
            pairs.append(max(seen, beside, key=lambda pair: pair.height))
    found = (_gaze_pair(streams), _carrying_pair(streams), _placing_pair(streams))
    return pairs + [pair for pair in found if pair is not None]


def _from_glasses(streams: Gridded, moving: _Moving) -> _Moving:
    """Return a place in the axes of the glasses, where these measured hands: their own movement would be in both."""
    if not (streams.recording.hands_from_glasses and streams.facing is not None and streams.head is not None):
        return moving
    points, known = streams.head
    return streams.facing.inv().apply(moving[0] - points), known & moving[1]


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
    turned = _turned(swaying[0][0][moving], swaying[1][0][moving])
    return _pair((one, other), "movement", _matched(*swaying), seconds, offset=offset, turned=turned)


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
        change, known = _speeds(streams.local)
        curve = _steadiness(streams, np.cross(streams.local[0], change), known)
        return _pair(("gaze", "head"), "gaze in head", curve, len(streams.turning) / RATE)
    assert body is not None, "without glasses the head is the body's"
    if float(np.median(np.linalg.norm(origin[0] - streams.head[0], axis=1)[origin[1]])) > 0.02:
        return _moving_pair("gaze", "body", origin, streams.head)
    forward, _ = head_forward(body.joints, recording.head_tilt_deg)
    turns = []
    for stream, directions in ((gaze, gaze.direction), (body, forward)):
        looked = _on_grid(stream.times, directions, stream.valid, streams.grid)
        change, known = _speeds(looked)
        turns.append((np.cross(looked[0], change), known))
    seconds = float((np.linalg.norm(turns[1][0], axis=1) > _TURNING).sum() / RATE)
    return _pair(("gaze", "body"), "gaze in world", _matched(*turns), seconds, natural=-_LEAD)


def _steadiness(streams: Gridded, eye: _Rows, known: np.ndarray) -> _Curve:
    """Return the share of a turning head's time in which gaze keeps its place, for eyes that are late by each lag.

    Rolling about the gaze moves no gaze, so only turns about x and y count.
    """
    assert streams.turn is not None, "asked of recordings with glasses"
    curve = np.zeros(len(_STEPS))
    for index, step in enumerate(_STEPS):
        rows = streams.turning
        rows = rows[(rows + step >= 0) & (rows + step < len(known))]
        rows = rows[known[rows + step]]
        drift = streams.turn[rows, :2] + eye[rows + step, :2]
        steady = np.exp(-(drift**2).sum(axis=1) / (2 * _STEADY**2))
        # Few instants would agree by chance.
        curve[index] = steady.sum() / max(len(rows), 0.2 * len(streams.turning), 1)
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
    hands = [
        (np.pad(speeds, ((_NO_LAG, _NO_LAG), (0, 0))), np.pad(known.astype(float), _NO_LAG))
        for speeds, known in map(_speeds, streams.hands.values())
    ]
    if not streams.carries or not hands:
        return None
    agreed = np.zeros(len(_STEPS))
    seen = np.zeros(len(_STEPS))
    besides = []
    for _, speeds, part in streams.carries:
        length = len(speeds)
        around = slice(part.start, part.stop + 2 * _NO_LAG)
        alike = np.zeros((len(hands), len(_STEPS)))
        known = np.zeros((len(hands), len(_STEPS)), dtype=bool)
        for row, (fast, its_known) in enumerate(hands):
            near = fast[around]
            together = sum(np.correlate(near[:, axis], speeds[:, axis], "valid") for axis in range(3))
            power = np.convolve((near**2).sum(axis=1), np.ones(length), "valid")
            floor = 0.05 * (speeds**2).sum()
            known[row] = np.convolve(its_known[around], np.ones(length), "valid") > 0.8 * length
            alike[row] = together / np.sqrt(np.maximum(power, floor) * (speeds**2).sum())
        agreed += length * np.where(known, alike, 0.0).max(axis=0)
        seen += length * known.any(axis=0)
        beside = [fast[around][_NO_LAG : _NO_LAG + length] for fast, _ in hands]
        besides.append(max(beside, key=lambda each, speeds=speeds: _turned(speeds, each)[0]))
    # An object that is late meets the hand of before. A stretch without a hand tells nothing.
    total = sum(len(speeds) for _, speeds, _ in streams.carries)
    curve = (agreed / np.maximum(seen, total / 2))[::-1]
    turned = _turned(np.concatenate([speeds for _, speeds, _ in streams.carries]), np.concatenate(besides))
    apart = _from_hands(streams, int(_STEPS[np.argmax(curve)]))
    offset = None if apart is None else np.median(apart, axis=0)
    return _pair(("objects", "hands"), "carrying", curve, float(seen[_NO_LAG]) / RATE, offset=offset, turned=turned)


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
    return _pair(("objects", "hands"), "places", curve, float(seen[:, _NO_LAG].sum()))


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


def _wrong_units(streams: Gridded, pairs: Sequence[Pair], found: _Found) -> dict[str, Diagnosis]:
    """Compare lengths with people's, in the unit that the reader took and in others."""
    wrong = dict(found)
    for stream, reference, measure, lengths, low, high in _lengths(streams, pairs):
        fits = (lengths >= low) & (lengths <= high)
        if fits[0] or not fits.any() or {stream, reference} & _blamed(streams, wrong):
            continue
        # Of several units that fit the one in which the length is the most usual.
        unusual = np.abs(np.log(np.maximum(lengths, 1e-9) / np.sqrt(low * high)))
        factor = _FACTORS[int(np.argmin(np.where(fits, unusual, np.inf)))]
        said = f"{stream}: {measure} is {lengths[0]:.3g} m, expected {low:g} to {high:g} m."
        cause = f"Its positions are {factor:g} times what they should be: another unit than the dataset's."
        wrong[stream] = Diagnosis("unit", True, said, cause, _options("scale", stream, f"{1 / factor:g}"))
    return wrong


def _options(option: str, stream: str, number: str) -> str:
    """Return what mends a stream; glasses carry their camera."""
    names = ("head", "camera") if stream == "head" else (stream,)
    return "Mend it with " + " ".join(f"--{option} {name}={number}" for name in names) + "."


def _lengths(streams: Gridded, pairs: Sequence[Pair]) -> Iterator[tuple[str, str, str, np.ndarray, float, float]]:
    """Yield a stream, what it is measured against, the measure, that length divided by each factor, people's range."""
    body = streams.recording.body
    head = streams.head
    if body is not None and body.valid.any():
        bones = np.median(bone_lengths(body.joints[body.valid]), axis=0)
        upright = bones[[joint - 1 for joint in _UPRIGHT]].sum()  # bones stand in the order of their lower ends
        yield "body", "body", "ankle to head along the bones", upright / _FACTORS, 0.9, 2.4
    if streams.turn is not None and head is not None:
        speeds, known = _speeds(head)
        rows = streams.turning[known[streams.turning]]
        if len(rows) > _NEEDED["movement"][1] * RATE:
            lever = np.linalg.norm(speeds[rows], axis=1) / np.linalg.norm(streams.turn[rows], axis=1)
            yield "head", "head", "its way for a radian of turning", np.median(lever) / _FACTORS, 0.02, 5.0
    for place, known in streams.hands.values():
        both = known if head is None else known & head[1]
        if head is not None and both.any():
            # Wrists that glasses measured lie beside the head in any unit.
            centre = head[0][both] * streams.recording.hands_from_glasses
            local = place[both] - centre
            away = [np.linalg.norm(centre + local / factor - head[0][both], axis=1) for factor in _FACTORS]
            reference = "body" if streams.turn is None else "head"
            yield "hands", reference, "the distance of a wrist from the head", np.median(away, axis=1), 0.1, 1.2
    late = next((pair.lag for pair in pairs if pair.one == "objects" and pair.sure), 0.0)
    carried = [_from_hands(streams, round(late * RATE), factor) for factor in _FACTORS]
    away = [np.median(np.linalg.norm(apart, axis=1)) for apart in carried if apart is not None]
    if away:
        measure = "the distance of carried ones from the nearer hand"
        yield "objects", "hands", measure, np.array(away), 0.005, _FARTHEST_OFFSET
    places = [event.location for event in streams.recording.annotated_events if event.location is not None]
    if places and head is not None and not streams.recording.objects:
        centre = np.median(head[0][head[1]], axis=0) if head[1].any() else np.zeros(3)
        away = [np.median(np.linalg.norm(np.stack(places) / factor - centre, axis=1)) for factor in _FACTORS]
        yield (
            "objects",
            "head",
            "the distance of their places from the middle of the head's way",
            np.array(away),
            0.2,
            15.0,
        )


def _wrong_axes(streams: Gridded, pairs: Sequence[Pair], found: _Found) -> dict[str, Diagnosis]:
    """Look for streams whose axes are not those of the world, or of the head."""
    wrong = dict(found)
    body = streams.recording.body
    glasses = streams.recording.head
    ups = {}
    if body is not None and body.valid.any():
        ankles = body.joints[:, [Joint.LEFT_ANKLE, Joint.RIGHT_ANKLE]].mean(axis=1)
        ups["body"] = np.median((body.joints[:, Joint.HEAD] - ankles)[body.valid], axis=0)
    if glasses.valid.any():
        turned = Rotation.from_quat(glasses.rotation[glasses.valid], scalar_first=True)
        ups["head"] = np.median(turned.apply((0.0, 1.0, 0.0)), axis=0)
    for name, up in ups.items():
        x, y, z = up / max(float(np.linalg.norm(up)), 1e-12)
        if y < _LEAST_UP and name not in _blamed(streams, wrong):
            said = f"{name}: its up is ({x:+.2f}, {y:+.2f}, {z:+.2f}), expected the second axis, at least {_LEAST_UP}."
            wrong[name] = Diagnosis("axes", True, said, "Two of its axes are exchanged, or one is turned.", _NO_OPTION)
    angle = _gaze_angle(streams)
    late = any(pair.sure and abs(pair.lag) > _TOLD_LAG for pair in pairs if pair.one == "gaze")
    if angle > _WIDEST_GAZE and not late and "gaze" not in _blamed(streams, wrong):
        said = (
            f"gaze: {angle:.0f} degrees from the head's forward axis in the median, expected at most {_WIDEST_GAZE:g}."
        )
        cause = "It has other axes than the head, or was turned into the world once too often or not at all."
        wrong["gaze"] = Diagnosis("axes", True, said, cause, _NO_OPTION)
    for pair in pairs:
        if pair.turned is not None and _unblamed(streams, [pair], wrong):
            best = np.abs(pair.turned).argmax(axis=1)
            signs = ["+-"[int(axes[at] < 0)] for axes, at in zip(pair.turned, best, strict=True)]
            axes = ", ".join(f"{'xyz'[row]} is {signs[row]}{'xyz'[at]}" for row, at in enumerate(best))
            name = max((pair.one, pair.other), key=_TRUSTED.index)
            said = f"{name}: {pair.one} and {pair.other} move together only if of {pair.one} {axes}; in their own axes"
            said += f" they agree by {pair.height:.2f} at best."
            wrong[name] = Diagnosis("axes", True, said, "Its axes are not those of the world.", _NO_OPTION)
    return wrong


def _gaze_angle(streams: Gridded) -> float:
    """Return the angle of gaze to the head's forward axis, or the face's, in the median, degrees; 0 where unknown."""
    gaze = streams.recording.gaze
    body = streams.recording.body
    forward = np.ones(1)
    if streams.local is not None:
        forward = streams.local[0][streams.local[1], 2]
    elif body is not None and body.valid.any() and gaze.valid.any():
        ahead, _ = head_forward(body.joints[body.valid], streams.recording.head_tilt_deg)
        seen = gaze.times[gaze.valid]
        forward = (interpolate(body.times[body.valid], ahead, seen) * gaze.direction[gaze.valid]).sum(axis=1)
    if len(forward) < _NEEDED["gaze in head"][1] * RATE:
        return 0.0
    return float(np.rad2deg(np.arccos(np.clip(np.median(forward), -1.0, 1.0))))


def _stuck(streams: Gridded) -> dict[str, Diagnosis]:
    """Look for streams that stand still to the last digit, which no person does."""
    parts = [("body", each) for each in streams.joints.values()] + [("hands", each) for each in streams.hands.values()]
    if streams.turn is not None and streams.head is not None:
        parts.append(("head", streams.head))
    if streams.local is not None:
        parts.append(("gaze", streams.local))
    found = {}
    for name, (points, known) in parts:
        still = runs((np.abs(np.diff(points, axis=0)).max(axis=1) < 1e-9) & known[1:])
        lasting = (still[:, 1] - still[:, 0]) / RATE
        frozen = float(lasting[lasting >= _LONGEST_STILL].sum())
        share = frozen * RATE / max(int(known.sum()), 1)
        if frozen:
            said = f"{name}: does not move at all for {frozen:.1f} s ({share:.0%} of its time), expected at most"
            said += f" {_LONGEST_STILL:g} s at a time."
            cause = "The sensor or its file repeats one value."
            # A head or a hand may be held still by whatever carries it; eyes never are.
            certain = name == "gaze" and share > 0.5
            found[name] = Diagnosis("stuck", certain, said, cause, "Copy or record it again.")
    return found


def _wrong_clock(name: str, lag: float, told: Pair) -> Diagnosis:
    """Say that a stream is late or early."""
    other = told.other if told.one == name else told.one
    said = f"{name}: {abs(lag):.2f} s {'late' if lag > 0 else 'early'}, expected within {_TOLD_LAG} s: there it agrees"
    said += f" best with {other} ({told.height:.2f}, at any other lag at most {told.second:.2f}, over"
    said += f" {told.seconds:.0f} {'s of movement' if told.offset is not None or told.one == 'gaze' else 'events'})."
    cause = "Its times are those of another clock."
    return Diagnosis("clock", abs(lag) >= _GROSS_LAG, said, cause, _options("shift", name, f"{-lag:.2f}"))
