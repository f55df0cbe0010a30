"""The form of a plan (every decision about body and objects of one recording), and how one movement of it is drawn.

Sources: docs/specification/synthetic-recordings.md#world, docs/specification/synthetic-recordings.md#base-motion,
docs/specification/synthetic-recordings.md#reaching-and-holding, docs/specification/synthetic-recordings.md#event-truth
and docs/specification/synthetic-recordings.md#provocations. Made by :mod:`planner`; the gaze is planned in
:mod:`gaze_plan`, the motion follows without further choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError
from prbench.synthetic.people.base import BasePose, Segment
from prbench.synthetic.people.grasp import Grasp, Posture
from prbench.synthetic.people.person import Person, seated_pelvis_height
from prbench.synthetic.people.places import Goal, Stand
from prbench.synthetic.people.presets import ObjectKind, Preset
from prbench.synthetic.people.world import Item, Room, world_half_extents

OPENING = 2.5
"""Seconds of standing before anything happens."""

Action = Literal["pick", "put", "hover", "pass_by", "touch", "nudge", "hinge"]


@dataclass(frozen=True)
class ReachChange:
    """Changes that a provocation makes to one reach; the default changes nothing.

    Source: docs/specification/synthetic-recordings.md#provocations.
    """

    gap: float | None = None
    """Forced time from the first look to the event."""
    second_hand: float = 0.0
    """Distance at which the other hand joins, metres; 0: it does not."""
    handed_over: float | None = None
    """Of a put: when the object began to change hands."""
    slide: Float[np.ndarray, "3"] | None = None
    """How far a nudged object slides."""
    opening: float = 0.0
    """Angle by which a hinged object is turned, radians."""
    lost: tuple[float, float] | None = None
    """Span in which tracking loses the object."""


@dataclass(frozen=True)
class Reach:
    """One purposeful movement of a hand: a pick, a put, or a movement that is neither."""

    number: int
    action: Action
    tag: str
    """``plain`` or a provocation."""
    item: int
    """Index of the object."""
    hand: int
    surface: int
    centre: Float[np.ndarray, "3"]
    """Centre of the object's box at rest: before a pick, after a put."""
    yaw: float
    half_world: Float[np.ndarray, "3"]
    base: BasePose
    grasp: Grasp
    posture: Posture
    motor_start: float
    reach_start: float
    contact: float
    """The wrist is at its target."""
    event: float
    """Planned event time; the object starts or stops moving about then."""
    dwell: float
    """Seconds that the hand stays after the event, unless it carries the object away."""
    carries: bool
    twist: ReachChange = ReachChange()


@dataclass(frozen=True)
class Plan:
    """All decisions about body and objects of one recording."""

    preset: Preset
    person: Person
    room: Room
    is_seated: bool
    start: BasePose
    items: tuple[Item, ...]
    """Objects that are handled, then those of the room that never move."""
    segments: tuple[Segment, ...]
    reaches: tuple[Reach, ...]

    @property
    def pelvis_height(self) -> float | None:
        """Height of a seated person's pelvis; None when standing."""
        return seated_pelvis_height(self.person.body) if self.is_seated else None


EXTRA = ("pass_by", "touch", "nudge", "hinge")
"""Movements of their own, before a pick."""
_OF_PAIR = ("two_handed", "hand_over", "same_place", "contained")
"""Ways to pick something and to put it."""
_OF_EVENT = ("too_near", "early", "swept", "lost")
"""Circumstances of a single event."""
_OF_OTHERS = ("bystander",)
_TAGS = (*EXTRA, *_OF_PAIR, *_OF_EVENT, *_OF_OTHERS)

_DEFAULT_SHARE = 0.10
"""Of the movements, for all tags together."""

TRAY = ObjectKind("WoodenTray", "tray", (0.13, 0.015, 0.10))
TRAY_HANDLE = np.array([0.0, 0.0, -0.075])
"""Where the tray is held, in its own frame; what it carries stands on the other side."""
TRAY_LOAD = np.array([0.0, 0.0, 0.05])
DOOR = ObjectKind("CabinetDoor", "door", (0.16, 0.20, 0.010))
DOOR_HANDLE = np.array([-0.13, 0.0, 0.005])
"""The hinge is at x = + half extent; the front looks along -z of the door's frame."""
HANDLE_HALF = np.array([0.025, 0.02, 0.025])


def shares_for(preset: Preset, wanted: Mapping[str, float] | None) -> dict[str, float]:
    """Return the share of each tag that can happen in a preset.

    Args:
        preset: Decides which tags are possible: nothing is put down in gimo, only adt records other people.
        wanted: Share of the movements for each tag; None: 10 % together.

    Raises:
        UsageError: if a tag is unknown or a share lies outside [0, 1].
    """
    possible = possible_tags(preset)
    if wanted is None:
        return {tag: _DEFAULT_SHARE / len(possible) for tag in possible}
    for tag, share in wanted.items():
        if tag not in _TAGS:
            raise UsageError(f"provocation '{tag}' is unknown. Take some of: {', '.join(_TAGS)}.")
        if not 0.0 <= share <= 1.0:
            raise UsageError(f"provocation '{tag}': expected a share from 0 to 1, found {share}.")
    return {tag: wanted[tag] for tag in possible if wanted.get(tag, 0.0) > 0.0}


def possible_tags(preset: Preset) -> tuple[str, ...]:
    """Return the tags that make sense in a preset."""
    if not preset.puts:
        return ("pass_by", "touch", "too_near", "early", "swept")
    without = set() if preset.name == "adt" else {"bystander"}
    if preset.table_only:
        without.add("hinge")
    return tuple(tag for tag in _TAGS if tag not in without)


def draw_tag(shares: Mapping[str, float], movements: int, is_first: bool, rng: np.random.Generator) -> str:
    """Draw the tag of the next pick (and its put), or ``plain``.

    Args:
        shares: Of the movements, for each tag.
        movements: Events that the tag stands for: two where everything picked is put.
        is_first: Whether these are the recording's first events; only they can be ``early``.
        rng: Of the provocations.
    """
    chance = rng.random()
    for tag, share in shares.items():
        if tag in _OF_OTHERS:
            continue
        chance -= share * movements
        if chance < 0.0:
            return "plain" if tag == "early" and not is_first else tag
    return "plain"


_DWELL = {"pick": 0.18, "put": 0.18, "hover": np.inf, "pass_by": 0.02, "touch": 0.5, "nudge": 0.35, "hinge": 1.25}
"""Seconds that the hand stays after the event; a hovering hand stays until it picks."""
_FROM_HOVER = 0.7  # of the usual time, for the short way from a hovering hand to the object
_LONGEST_GAP = 9.7


@dataclass(frozen=True)
class Pair:
    """Properties that a pick and its put have in common."""

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
    """Return the tag that a movement itself carries."""
    if action == "hover":
        return "too_near"
    if action in EXTRA:
        return action
    if pair.tag in _OF_PAIR:
        return pair.tag
    if pair.tag in ("too_near", "early"):
        return pair.tag if action == "pick" else "plain"
    return pair.tag if pair.tag in _OF_EVENT and action == pair.tagged_event else "plain"


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
    action = movement.action
    tag = movement.tag
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
) -> ReachChange:
    draw = provoker.uniform
    if action == "nudge":
        away = goal.centre - stand.grasp.wrist
        away[1] = 0.0
        return ReachChange(slide=float(draw(0.008, 0.018)) * away / np.linalg.norm(away))
    if action == "hinge":
        return ReachChange(opening=float(draw(0.55, 0.8)))
    if tag == "two_handed":
        return ReachChange(second_hand=float(draw(0.10, 0.16)))
    if tag == "too_near" and action == "pick":
        return ReachChange(gap=float(draw(0.42, 0.55)))
    if tag == "early":
        return ReachChange(gap=min(event - float(draw(0.6, 1.7)), _LONGEST_GAP))
    if tag == "lost":
        before = float(draw(0.1, 0.5))
        after = float(draw(0.2, 0.5))
        return ReachChange(lost=(event - before, event + after))
    return ReachChange()
