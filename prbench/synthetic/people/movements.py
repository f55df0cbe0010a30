"""One movement of a hand: when it starts, how long it takes, and what a provocation changes about it.

Sources: docs/specification/synthetic-recordings.md#reaching-and-holding (timing),
docs/specification/synthetic-recordings.md#event-truth and docs/specification/synthetic-recordings.md#provocations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prbench.synthetic.people.person import Person
from prbench.synthetic.people.places import Goal, Stand
from prbench.synthetic.people.plan import Action, Reach, Twist
from prbench.synthetic.people.presets import Preset
from prbench.synthetic.people.provocations import EXTRA, OF_EVENT, OF_PAIR
from prbench.synthetic.people.world import world_half_extents

_DWELL = {"pick": 0.18, "put": 0.18, "hover": np.inf, "pass_by": 0.02, "touch": 0.5, "nudge": 0.35, "hinge": 1.25}
"""Seconds that the hand stays after the event; a hovering hand stays until it picks."""
_FROM_HOVER = 0.7  # of the usual time, for the short way from a hovering hand to the object
_LONGEST_GAP = 9.7


@dataclass(frozen=True)
class Pair:
    """What a pick and its put have in common."""

    tag: str
    tagged_event: str
    """Which of the two a tag of single events means: pick or put."""


@dataclass(frozen=True)
class Movement:
    """Which hand does what to which object, and from when on."""

    number: int
    action: Action
    tag: str
    item: int
    hand: int
    motor_start: float


def tag_of(pair: Pair, action: Action) -> str:
    """The tag that a movement itself carries."""
    if action == "hover":
        return "too_near"
    if action in EXTRA:
        return action
    if pair.tag in OF_PAIR:
        return pair.tag
    if pair.tag in ("too_near", "early"):
        return pair.tag if action == "pick" else "plain"
    return pair.tag if pair.tag in OF_EVENT and action == pair.tagged_event else "plain"


def make_reach(
    preset: Preset,
    person: Person,
    movement: Movement,
    goal: Goal,
    stand: Stand,
    rng: np.random.Generator,
    provoker: np.random.Generator,
) -> Reach:
    """Draw the timing of a movement.

    Args:
        preset: Whether what is picked is carried away.
        person: How fast they reach.
        movement: What is done.
        goal: To what.
        stand: From where and how.
        rng: Of the plan.
        provoker: Of the provocations.
    """
    action, tag = movement.action, movement.tag
    arrival = movement.motor_start if stand.segment is None else stand.segment.arrival
    reach_start = max(movement.motor_start, arrival - float(rng.uniform(0.15, 0.45)))
    length = (0.62 + 0.35 * rng.random()) * person.habits.reach_time + rng.uniform(0.03, 0.12)
    from_hover = tag == "too_near" and action == "pick"
    event = reach_start + float(length) * (_FROM_HOVER if from_hover else 1.0)
    return Reach(
        number=movement.number,
        action=action,
        tag=tag,
        item=movement.item,
        hand=movement.hand,
        surface=goal.surface,
        centre=goal.centre,
        yaw=stand.yaw,
        half_world=world_half_extents(goal.half_extents, stand.yaw),
        base=stand.base,
        grasp=stand.grasp,
        posture=stand.posture,
        motor_start=movement.motor_start,
        reach_start=reach_start,
        contact=event - 0.04,
        event=event,
        dwell=_DWELL[action],
        carries=action == "pick" and preset.puts,
        twist=_draw_twist(action, tag, goal, stand, event, provoker),
    )


def _draw_twist(
    action: Action, tag: str, goal: Goal, stand: Stand, event: float, provoker: np.random.Generator
) -> Twist:
    draw = provoker.uniform
    if action == "nudge":
        away = goal.centre - stand.grasp.wrist
        away[1] = 0.0
        return Twist(slide=float(draw(0.008, 0.018)) * away / np.linalg.norm(away))
    if action == "hinge":
        return Twist(opening=float(draw(0.55, 0.8)))
    if tag == "two_handed":
        return Twist(second_hand=float(draw(0.10, 0.16)))
    if tag == "too_near" and action == "pick":
        return Twist(gap=float(draw(0.42, 0.55)))
    if tag == "early":
        return Twist(gap=min(event - float(draw(0.6, 1.7)), _LONGEST_GAP))
    if tag == "lost":
        before, after = float(draw(0.1, 0.5)), float(draw(0.2, 0.5))
        return Twist(lost=(event - before, event + after))
    return Twist()
