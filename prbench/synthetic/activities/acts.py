"""The activities: what somebody does for some seconds, as commands on a stage.

Each adds its movements and says when it begins and ends. Its words are chosen later, from what then happened
(docs/specification/synthetic-recordings.md#text).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from prbench.synthetic.activities.stage import SITTING_TIME, Hand, Loop, Stage

_SPEEDS = ((0.5, 0.65), (0.8, 1.1), (0.8, 1.1), (1.28, 1.32))
"""Slow, normal (twice as often) and brisk walking, metres a second; nobody turns a corner briskly."""
_CARRY = (-0.05, -0.17, 0.19)
_CARRY_BOTH = (-0.015, -0.17, 0.19)
_NO_CORNER = 0.1  # rad
_BULGE = 0.22  # m
_WAVING_ELBOW = (1.0, -0.8, 0.0)


def _walk(stage: Stage, turn: float) -> None:
    begin = stage.now
    speeds = _SPEEDS if abs(turn) < _NO_CORNER else _SPEEDS[:-1]
    speed = stage.draw(*speeds[int(stage.rng.integers(len(speeds)))])
    distance = speed * stage.draw(2.4, 3.0)
    segment = stage.go(stage.ahead(distance, stage.base.heading + turn), stage.pace(speed, distance))
    stage.did("walk", begin, begin + 3.0 if segment is None else segment.end)


def _walk_straight(stage: Stage) -> None:
    """Walk ahead; slowly, normally or briskly."""
    _walk(stage, stage.draw(-0.05, 0.05))


def _walk_left(stage: Stage) -> None:
    """Turn to the left and walk."""
    _walk(stage, stage.draw(0.6, 1.7))


def _walk_right(stage: Stage) -> None:
    """Turn to the right and walk."""
    _walk(stage, -stage.draw(0.6, 1.7))


def _walk_curve(stage: Stage) -> None:
    """Walk along an arc."""
    begin = stage.now
    length = stage.draw(2.4, 3.6)
    arc = stage.curve(length, stage.side() * stage.draw(0.8, 1.6), stage.pace(stage.draw(0.8, 1.05), length))
    stage.did("curve", begin, arc.end)


def _walk_carrying(stage: Stage) -> None:
    """Walk with one or both hands held before the chest, as with something in them."""
    begin, hand = stage.now, int(stage.rng.integers(3))
    hands = (0, 1) if hand == 2 else (hand,)
    for one in hands:
        stage.move_hand(one, begin, 0.75, "shoulder", _CARRY_BOTH if hand == 2 else _CARRY)
    stage.now += 0.5
    segment = stage.go(
        stage.ahead(stage.draw(1.8, 2.6), stage.base.heading + stage.draw(-0.2, 0.2)), stage.draw(0.8, 1.0)
    )
    end = stage.now + 3.0 if segment is None else segment.end
    for one in hands:
        stage.rest(one, end - 0.1, 0.9)
    stage.did("carry", begin, end + 0.3, hand)


def _turn_around(stage: Stage) -> None:
    """Turn on the spot."""
    begin = stage.now
    angle = stage.side() * stage.draw(0.55, 3.0)
    heading = stage.base.heading + angle
    stage.look(begin - 0.1, begin + 0.9, float(np.clip(angle, -1.4, 1.4)), 0.1)
    segment = stage.go(replace(stage.base, heading=heading), 1.0)
    stage.did("turn", begin, begin + 1.5 if segment is None else segment.end)


def stand(stage: Stage) -> None:
    """Stand, or sit, without doing anything."""
    stage.did("sit" if stage.is_seated else "stand", stage.now, stage.now + stage.draw(2.2, 3.4))


def look_around(stage: Stage) -> None:
    """Look far to both sides in turn."""
    begin, time, side = stage.now, stage.now, stage.side()
    for _ in range(int(stage.rng.integers(3, 5))):
        length = stage.draw(0.75, 1.15)
        stage.look(time, time + length, side * stage.draw(0.7, 1.35), stage.draw(-0.15, 0.3))
        time, side = time + length, -side
    stage.did("look around", begin, time)


def _look_at_hands(stage: Stage) -> None:
    """Hold both hands before the chest and look at them."""
    begin, length = stage.now, stage.draw(2.6, 3.6)
    for hand in (0, 1):
        stage.move_hand(hand, begin, 0.8, "shoulder", (-0.05, -0.10, 0.17))
        stage.rest(hand, begin + length - 0.8, 0.8)
    stage.look_at(begin + 0.2, begin + length - 0.6, stage.before_chest(-0.24, 0.19))
    stage.did("look at hands", begin, begin + length)


def _step_sideways(stage: Stage) -> None:
    """Step sideways, still facing the same way."""
    begin, side = stage.now, stage.side()
    goal = stage.base.point + side * stage.draw(0.3, 0.6) * stage.base.left
    segment = stage.go(replace(stage.base, x=float(goal[0]), z=float(goal[2])), 1.0)
    stage.did("sidestep", begin, begin + 1.5 if segment is None else segment.end)


def _step_back(stage: Stage) -> None:
    """Step backwards."""
    begin = stage.now
    goal = stage.base.point - stage.draw(0.3, 0.55) * stage.base.forward
    segment = stage.go(replace(stage.base, x=float(goal[0]), z=float(goal[2])), 1.0)
    stage.did("step back", begin, begin + 1.5 if segment is None else segment.end)


def _reach_out(stage: Stage) -> None:
    """Reach for something without taking it."""
    begin, hand = stage.now + 0.2, stage.free_hand()
    outwards = (1.0 if hand == 0 else -1.0) * stage.draw(0.02, 0.20)
    point = stage.base.point + stage.draw(0.42, 0.58) * stage.base.forward + outwards * stage.base.left
    point[1] = stage.stature * stage.draw(0.42, 0.92)
    end = stage.reach(hand, point, begin, stage.draw(0.75, 1.1), stage.draw(0.3, 0.7))
    stage.did("reach", stage.now, end, hand)


def _rub(stage: Stage, name: str, size: tuple[float, float], frequency: tuple[float, float]) -> None:
    begin, hand, length = stage.now, stage.free_hand(), stage.draw(3.0, 4.2)
    half, ratio = stage.draw(*size) / 2.0, stage.draw(0.5, 1.0)
    loop = Loop(
        begin + 0.7, begin + length - 0.7, np.array([half, 0.0, 0.0]), np.array([0.0, 0.0, half * ratio]),
        stage.draw(*frequency),
    )  # fmt: skip
    stage.script.hands.append(Hand(hand, begin, 0.8, "middle", (-0.02, -0.22, 0.21), loop))
    stage.rest(hand, begin + length - 0.75, 0.8)
    stage.look_at(begin + 0.1, begin + length - 0.5, stage.before_chest(-0.35, 0.24))
    if not stage.is_seated:
        stage.bend(begin, 0.7, stage.draw(0.10, 0.25), 0.0)
        stage.bend(begin + length - 0.8, 0.7, 0.0, 0.0)
    stage.did(name, begin, begin + length, hand)


def wipe(stage: Stage) -> None:
    """Move a hand in wide circles before the body, as on a table."""
    _rub(stage, "wipe", (0.12, 0.15), (0.8, 1.2))


def stir(stage: Stage) -> None:
    """Move a hand in small quick circles, as in a pot."""
    _rub(stage, "stir", (0.08, 0.10), (1.2, 1.6))


def crouch(stage: Stage) -> None:
    """Go down with bent knees, and up again."""
    begin, depth = stage.now, stage.draw(0.32, 0.48)
    down = 0.8 + 1.25 * depth
    stay = stage.draw(0.4, 1.0)
    stage.bend(begin, down, stage.draw(0.35, 0.6), depth)
    stage.bend(begin + down + stay, down, 0.0, 0.0)
    stage.did("crouch", begin, begin + 2 * down + stay)


def _bend_forward(stage: Stage) -> None:
    """Lean forward with nearly straight legs, and up again."""
    begin, length, stay = stage.now, stage.draw(1.0, 1.3), stage.draw(0.4, 1.0)
    stage.bend(begin, length, stage.draw(0.75, 1.15), stage.draw(0.02, 0.06))
    stage.look(begin + 0.1, begin + length + stay, 0.0, 1.0, 1.2)
    stage.bend(begin + length + stay, length, 0.0, 0.0)
    stage.did("bend", begin, begin + 2 * length + stay)


def wave(stage: Stage) -> None:
    """Wave a hand beside the head."""
    begin, hand = stage.now, stage.free_hand()
    frequency, cycles = stage.draw(1.5, 2.5), int(stage.rng.integers(3, 7))
    waving = cycles / frequency
    loop = Loop(begin + 0.75, begin + 0.75 + waving, np.array([0.05, 0.0, 0.0]), np.array([0.0, 0.015, 0.0]), frequency)
    stage.script.hands.append(Hand(hand, begin, 0.8, "shoulder", (0.09, 0.105, 0.08), loop, _WAVING_ELBOW, _BULGE))
    end = begin + 0.75 + waving
    stage.rest(hand, end, 0.9, bulge=_BULGE)
    stage.look(begin, end, stage.draw(-0.2, 0.2), 0.0)
    stage.did("wave", begin, end + 0.8, hand)


def _raise_arms(stage: Stage) -> None:
    """Raise both arms, and lower them again."""
    begin, up, stay = stage.now, stage.draw(0.9, 1.2), stage.draw(0.4, 1.1)
    for hand in (0, 1):
        stage.move_hand(hand, begin, up, "shoulder", (stage.draw(0.02, 0.06), 0.265, 0.05), bulge=_BULGE)
        stage.rest(hand, begin + up + stay, up, bulge=_BULGE)
    stage.did("raise arms", begin, begin + 2 * up + stay)


def _scratch_head(stage: Stage) -> None:
    """Rub the head with a hand."""
    begin, hand, length = stage.now, stage.free_hand(), stage.draw(2.8, 3.8)
    loop = Loop(
        begin + 0.8,
        begin + length - 0.8,
        np.array([0.0, 0.012, 0.0]),
        np.array([0.0, 0.0, 0.014]),
        stage.draw(2.0, 3.0),
    )
    stage.script.hands.append(Hand(hand, begin, 0.9, "head", (0.075, 0.045, 0.035), loop, (1.0, -0.3, 0.15), _BULGE))
    stage.rest(hand, begin + length - 0.85, 0.9, bulge=_BULGE)
    stage.did("scratch head", begin, begin + length, hand)


def _sit_down(stage: Stage) -> None:
    """Sit down on a chair that is not shown."""
    begin = stage.now
    stage.sit(down=True)
    stage.did("sit down", begin, begin + SITTING_TIME + 0.6)


def _stand_up(stage: Stage) -> None:
    """Stand up from the chair."""
    begin = stage.now
    stage.sit(down=False)
    stage.did("stand up", begin, begin + SITTING_TIME + 0.5)


Activity = Callable[[Stage], None]

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
