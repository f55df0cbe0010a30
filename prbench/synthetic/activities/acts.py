"""The activities: what somebody does for some seconds, written as commands into a script.

Each adds its movements and says when it begins and ends. Its words are chosen later, from what then happened
(docs/specification/synthetic-recordings.md#text).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from prbench.synthetic.activities.script import SITTING_TIME, Hand, Loop, ScriptWriter

_SPEEDS = ((0.5, 0.65), (0.8, 1.1), (0.8, 1.1), (1.28, 1.32))
"""Slow, normal (twice as often) and brisk walking, metres a second; nobody turns a corner briskly."""
_CARRY = (-0.05, -0.17, 0.19)
_CARRY_BOTH = (-0.015, -0.17, 0.19)
_NO_CORNER = 0.1  # rad
_BULGE = 0.22  # m
_WAVING_ELBOW = (1.0, -0.8, 0.0)


def _walk(writer: ScriptWriter, turn: float) -> None:
    begin = writer.now
    speeds = _SPEEDS if abs(turn) < _NO_CORNER else _SPEEDS[:-1]
    speed = writer.draw(*speeds[int(writer.rng.integers(len(speeds)))])
    distance = speed * writer.draw(2.4, 3.0)
    segment = writer.go(writer.ahead(distance, writer.base.heading + turn), writer.pace(speed, distance))
    writer.did("walk", begin, begin + 3.0 if segment is None else segment.end)


def _walk_straight(writer: ScriptWriter) -> None:
    """Walk ahead; slowly, normally or briskly."""
    _walk(writer, writer.draw(-0.05, 0.05))


def _walk_left(writer: ScriptWriter) -> None:
    """Turn to the left and walk."""
    _walk(writer, writer.draw(0.6, 1.7))


def _walk_right(writer: ScriptWriter) -> None:
    """Turn to the right and walk."""
    _walk(writer, -writer.draw(0.6, 1.7))


def _walk_curve(writer: ScriptWriter) -> None:
    """Walk along an arc."""
    begin = writer.now
    length = writer.draw(2.4, 3.6)
    arc = writer.curve(length, writer.side() * writer.draw(0.8, 1.6), writer.pace(writer.draw(0.8, 1.05), length))
    writer.did("curve", begin, arc.end)


def _walk_carrying(writer: ScriptWriter) -> None:
    """Walk with one or both hands held before the chest, as with something in them."""
    begin = writer.now
    hand = int(writer.rng.integers(3))
    hands = (0, 1) if hand == 2 else (hand,)
    for one in hands:
        writer.move_hand(one, begin, 0.75, "shoulder", _CARRY_BOTH if hand == 2 else _CARRY)
    writer.now += 0.5
    segment = writer.go(
        writer.ahead(writer.draw(1.8, 2.6), writer.base.heading + writer.draw(-0.2, 0.2)), writer.draw(0.8, 1.0)
    )
    end = writer.now + 3.0 if segment is None else segment.end
    for one in hands:
        writer.rest(one, end - 0.1, 0.9)
    writer.did("carry", begin, end + 0.3, hand)


def _turn_around(writer: ScriptWriter) -> None:
    """Turn on the spot."""
    begin = writer.now
    angle = writer.side() * writer.draw(0.55, 3.0)
    heading = writer.base.heading + angle
    writer.look(begin - 0.1, begin + 0.9, float(np.clip(angle, -1.4, 1.4)), 0.1)
    segment = writer.go(replace(writer.base, heading=heading), 1.0)
    writer.did("turn", begin, begin + 1.5 if segment is None else segment.end)


def stand(writer: ScriptWriter) -> None:
    """Stand, or sit, without doing anything."""
    writer.did("sit" if writer.is_seated else "stand", writer.now, writer.now + writer.draw(2.2, 3.4))


def look_around(writer: ScriptWriter) -> None:
    """Look far to both sides in turn."""
    begin = writer.now
    time = writer.now
    side = writer.side()
    for _ in range(int(writer.rng.integers(3, 5))):
        length = writer.draw(0.75, 1.15)
        writer.look(time, time + length, side * writer.draw(0.7, 1.35), writer.draw(-0.15, 0.3))
        time = time + length
        side = -side
    writer.did("look around", begin, time)


def _look_at_hands(writer: ScriptWriter) -> None:
    """Hold both hands before the chest and look at them."""
    begin = writer.now
    length = writer.draw(2.6, 3.6)
    for hand in (0, 1):
        writer.move_hand(hand, begin, 0.8, "shoulder", (-0.05, -0.10, 0.17))
        writer.rest(hand, begin + length - 0.8, 0.8)
    writer.look_at(begin + 0.2, begin + length - 0.6, writer.before_chest(-0.24, 0.19))
    writer.did("look at hands", begin, begin + length)


def _step_sideways(writer: ScriptWriter) -> None:
    """Step sideways, still facing the same way."""
    begin = writer.now
    side = writer.side()
    goal = writer.base.point + side * writer.draw(0.3, 0.6) * writer.base.left
    segment = writer.go(replace(writer.base, x=float(goal[0]), z=float(goal[2])), 1.0)
    writer.did("sidestep", begin, begin + 1.5 if segment is None else segment.end)


def _step_back(writer: ScriptWriter) -> None:
    """Step backwards."""
    begin = writer.now
    goal = writer.base.point - writer.draw(0.3, 0.55) * writer.base.forward
    segment = writer.go(replace(writer.base, x=float(goal[0]), z=float(goal[2])), 1.0)
    writer.did("step back", begin, begin + 1.5 if segment is None else segment.end)


def _reach_out(writer: ScriptWriter) -> None:
    """Reach for something without taking it."""
    begin = writer.now + 0.2
    hand = writer.free_hand()
    outwards = (1.0 if hand == 0 else -1.0) * writer.draw(0.02, 0.20)
    point = writer.base.point + writer.draw(0.42, 0.58) * writer.base.forward + outwards * writer.base.left
    point[1] = writer.stature * writer.draw(0.42, 0.92)
    end = writer.reach(hand, point, begin, writer.draw(0.75, 1.1), writer.draw(0.3, 0.7))
    writer.did("reach", writer.now, end, hand)


def _rub(writer: ScriptWriter, name: str, size: tuple[float, float], frequency: tuple[float, float]) -> None:
    begin = writer.now
    hand = writer.free_hand()
    length = writer.draw(3.0, 4.2)
    half = writer.draw(*size) / 2.0
    ratio = writer.draw(0.5, 1.0)
    loop = Loop(
        begin + 0.7, begin + length - 0.7, np.array([half, 0.0, 0.0]), np.array([0.0, 0.0, half * ratio]),
        writer.draw(*frequency),
    )  # fmt: skip
    writer.script.hands.append(Hand(hand, begin, 0.8, "middle", (-0.02, -0.22, 0.21), loop))
    writer.rest(hand, begin + length - 0.75, 0.8)
    writer.look_at(begin + 0.1, begin + length - 0.5, writer.before_chest(-0.35, 0.24))
    if not writer.is_seated:
        writer.bend(begin, 0.7, writer.draw(0.10, 0.25), 0.0)
        writer.bend(begin + length - 0.8, 0.7, 0.0, 0.0)
    writer.did(name, begin, begin + length, hand)


def wipe(writer: ScriptWriter) -> None:
    """Move a hand in wide circles before the body, as on a table."""
    _rub(writer, "wipe", (0.12, 0.15), (0.8, 1.2))


def stir(writer: ScriptWriter) -> None:
    """Move a hand in small quick circles, as in a pot."""
    _rub(writer, "stir", (0.08, 0.10), (1.2, 1.6))


def crouch(writer: ScriptWriter) -> None:
    """Go down with bent knees, and up again."""
    begin = writer.now
    depth = writer.draw(0.32, 0.48)
    down = 0.8 + 1.25 * depth
    stay = writer.draw(0.4, 1.0)
    writer.bend(begin, down, writer.draw(0.35, 0.6), depth)
    writer.bend(begin + down + stay, down, 0.0, 0.0)
    writer.did("crouch", begin, begin + 2 * down + stay)


def _bend_forward(writer: ScriptWriter) -> None:
    """Lean forward with nearly straight legs, and up again."""
    begin = writer.now
    length = writer.draw(1.0, 1.3)
    stay = writer.draw(0.4, 1.0)
    writer.bend(begin, length, writer.draw(0.75, 1.15), writer.draw(0.02, 0.06))
    writer.look(begin + 0.1, begin + length + stay, 0.0, 1.0, 1.2)
    writer.bend(begin + length + stay, length, 0.0, 0.0)
    writer.did("bend", begin, begin + 2 * length + stay)


def wave(writer: ScriptWriter) -> None:
    """Wave a hand beside the head."""
    begin = writer.now
    hand = writer.free_hand()
    frequency = writer.draw(1.5, 2.5)
    cycles = int(writer.rng.integers(3, 7))
    waving = cycles / frequency
    loop = Loop(begin + 0.75, begin + 0.75 + waving, np.array([0.05, 0.0, 0.0]), np.array([0.0, 0.015, 0.0]), frequency)
    writer.script.hands.append(Hand(hand, begin, 0.8, "shoulder", (0.09, 0.105, 0.08), loop, _WAVING_ELBOW, _BULGE))
    end = begin + 0.75 + waving
    writer.rest(hand, end, 0.9, bulge=_BULGE)
    writer.look(begin, end, writer.draw(-0.2, 0.2), 0.0)
    writer.did("wave", begin, end + 0.8, hand)


def _raise_arms(writer: ScriptWriter) -> None:
    """Raise both arms, and lower them again."""
    begin = writer.now
    up = writer.draw(0.9, 1.2)
    stay = writer.draw(0.4, 1.1)
    for hand in (0, 1):
        writer.move_hand(hand, begin, up, "shoulder", (writer.draw(0.02, 0.06), 0.265, 0.05), bulge=_BULGE)
        writer.rest(hand, begin + up + stay, up, bulge=_BULGE)
    writer.did("raise arms", begin, begin + 2 * up + stay)


def _scratch_head(writer: ScriptWriter) -> None:
    """Rub the head with a hand."""
    begin = writer.now
    hand = writer.free_hand()
    length = writer.draw(2.8, 3.8)
    loop = Loop(
        begin + 0.8,
        begin + length - 0.8,
        np.array([0.0, 0.012, 0.0]),
        np.array([0.0, 0.0, 0.014]),
        writer.draw(2.0, 3.0),
    )
    writer.script.hands.append(Hand(hand, begin, 0.9, "head", (0.075, 0.045, 0.035), loop, (1.0, -0.3, 0.15), _BULGE))
    writer.rest(hand, begin + length - 0.85, 0.9, bulge=_BULGE)
    writer.did("scratch head", begin, begin + length, hand)


def _sit_down(writer: ScriptWriter) -> None:
    """Sit down on a chair that is not shown."""
    begin = writer.now
    writer.sit(down=True)
    writer.did("sit down", begin, begin + SITTING_TIME + 0.6)


def _stand_up(writer: ScriptWriter) -> None:
    """Stand up from the chair."""
    begin = writer.now
    writer.sit(down=False)
    writer.did("stand up", begin, begin + SITTING_TIME + 0.5)


Activity = Callable[[ScriptWriter], None]

STANDING: Mapping[Activity, float] = MappingProxyType(
    {
        _walk_straight: 1.6, _walk_left: 1.0, _walk_right: 1.0, _walk_curve: 1.0, _walk_carrying: 1.0,
        _turn_around: 1.4,
        stand: 0.5, look_around: 1.0, _look_at_hands: 0.7, _step_sideways: 1.0, _step_back: 0.8, _reach_out: 1.6,
        wipe: 0.8, stir: 0.8, crouch: 0.8, _bend_forward: 0.8, wave: 0.9, _raise_arms: 0.7, _scratch_head: 0.6,
        _sit_down: 0.9,
    }
)  # fmt: skip
"""What somebody who stands may do next, by weight."""

SITTING: Mapping[Activity, float] = MappingProxyType(
    {stand: 0.8, look_around: 0.8, _look_at_hands: 0.7, wave: 0.6, _scratch_head: 0.5, stir: 0.5, _stand_up: 1.8}
)
"""The same for somebody who sits."""

PAUSE = (0.32, 0.7)
"""Seconds between two activities; sooner the last foot would not have landed."""

SHORT = frozenset({"turn", "sidestep", "step back", "sit down", "stand up"})
"""Activities that leave time for a second one in the same narration."""
