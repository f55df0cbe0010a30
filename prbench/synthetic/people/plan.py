"""Decides everything about body and objects of one recording: what goes where, from which place, with which hand, when.

Sources: docs/specification/synthetic-recordings.md#world, docs/specification/synthetic-recordings.md#base-motion,
docs/specification/synthetic-recordings.md#reaching-and-holding, docs/specification/synthetic-recordings.md#event-truth
and docs/specification/synthetic-recordings.md#provocations. The gaze is planned in :mod:`gaze_plan`; the motion follows
without further choices.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
from jaxtyping import Float

from prbench.errors import UsageError
from prbench.synthetic.people.kinematics import UP, turn
from prbench.synthetic.people.person import ObjectKind, Person, Preset, seated_pelvis_height
from prbench.synthetic.people.reaching import (
    Goal,
    Grasp,
    Held,
    Posture,
    Reachability,
    Reacher,
    Stand,
    kept_away,
    shoulder_in_posture,
)
from prbench.synthetic.people.walking import BasePose, Segment
from prbench.synthetic.people.world import Item, Room, draw_item_shape, draw_spot, world_half_extents

# Seconds of standing before anything happens.
OPENING = 2.5

Action = Literal["pick", "put", "hover", "pass_by", "touch", "nudge", "hinge"]


@dataclass(frozen=True)
class Reach:
    """One purposeful movement of a hand: a pick, a put, or a movement that is neither.

    Attributes:
        tag: ``plain`` or a provocation.
        item: Index of the object.
        centre: Centre of the object's box at rest: before a pick, after a put.
        contact: The wrist is at its target.
        event: Planned event time; the object starts or stops moving about then.
        dwell: Seconds that the hand stays after the event, unless it carries the object away.
        gap: Forced time from the first look to the event.
        second_hand: Distance at which the other hand joins, metres; 0: it does not.
        handed_over: Time at which the object of a put began to change hands.
        slide: How far a nudged object slides.
        opening: Angle by which a hinged object is turned, radians.
        lost: Span in which tracking loses the object.
    """

    number: int
    action: Action
    tag: str
    item: int
    hand: int
    surface: int
    centre: Float[np.ndarray, "3"]
    yaw: float
    half_world: Float[np.ndarray, "3"]
    base: BasePose
    grasp: Grasp
    posture: Posture
    motor_start: float
    reach_start: float
    contact: float
    event: float
    dwell: float
    carries: bool
    # What a provocation changes (docs/specification/synthetic-recordings.md#provocations).
    gap: float | None = None
    second_hand: float = 0.0
    handed_over: float | None = None
    slide: Float[np.ndarray, "3"] | None = None
    opening: float = 0.0
    lost: tuple[float, float] | None = None


@dataclass(frozen=True)
class Plan:
    """All decisions about body and objects of one recording.

    Attributes:
        items: Objects that are handled, then those of the room that never move.
    """

    preset: Preset
    person: Person
    room: Room
    is_seated: bool
    start: BasePose
    items: tuple[Item, ...]
    segments: tuple[Segment, ...]
    reaches: tuple[Reach, ...]

    @property
    def pelvis_height(self) -> float | None:
        """Height of a seated person's pelvis; None when standing."""
        return seated_pelvis_height(self.person.body) if self.is_seated else None


# Movements of their own, before a pick.
EXTRA = ("pass_by", "touch", "nudge", "hinge")
# Ways to pick something and to put it.
_OF_PAIR = ("two_handed", "hand_over", "same_place", "contained")
# Circumstances of a single event.
_OF_EVENT = ("too_near", "early", "swept", "lost")
_OF_OTHERS = ("bystander",)
_TAGS = (*EXTRA, *_OF_PAIR, *_OF_EVENT, *_OF_OTHERS)

# Share of the movements for all tags together.
_DEFAULT_SHARE = 0.10

TRAY = ObjectKind("WoodenTray", "tray", (0.13, 0.015, 0.10))
# Place at which the tray is held, in its own frame; its load stands on the other side.
TRAY_HANDLE = np.array([0.0, 0.0, -0.075])
TRAY_LOAD = np.array([0.0, 0.0, 0.05])
DOOR = ObjectKind("CabinetDoor", "door", (0.16, 0.20, 0.010))
# The hinge is at x = + half extent; the front looks along -z of the door's frame.
DOOR_HANDLE = np.array([-0.13, 0.0, 0.005])
HANDLE_HALF = np.array([0.025, 0.02, 0.025])


def shares_for(preset: Preset, wanted: Mapping[str, float] | None) -> dict[str, float]:
    """Return the share of each tag that can happen in a preset.

    Args:
        preset: Decides which tags are possible: nothing is put down in gimo, only adt records other people.
        wanted: Share of the movements for each tag; None: 10 % together.

    Raises:
        UsageError: if a tag is unknown or a share lies outside [0, 1].
    """
    possible = ("pass_by", "touch", "too_near", "early", "swept")
    if preset.puts:
        without = set() if preset.name == "adt" else {"bystander"}
        if preset.table_only:
            without.add("hinge")
        possible = tuple(tag for tag in _TAGS if tag not in without)
    if wanted is None:
        return {tag: _DEFAULT_SHARE / len(possible) for tag in possible}
    for tag, share in wanted.items():
        if tag not in _TAGS:
            raise UsageError(f"provocation '{tag}' is unknown. Take some of: {', '.join(_TAGS)}.")
        if not 0.0 <= share <= 1.0:
            raise UsageError(f"provocation '{tag}': expected a share from 0 to 1, found {share}.")
    return {tag: wanted[tag] for tag in possible if wanted.get(tag, 0.0) > 0.0}


def draw_tag(shares: Mapping[str, float], movements: int, is_first: bool, rng: np.random.Generator) -> str:
    """Draw the tag of the next pick (and its put), or ``plain``.

    Args:
        shares: Share of the movements for each tag.
        movements: Events that the tag stands for: two where everything picked is put.
        is_first: Whether these are the recording's first events; only they can be ``early``.
        rng: Generator of the provocations.
    """
    chance = rng.random()
    for tag, share in shares.items():
        if tag in _OF_OTHERS:
            continue
        chance -= share * movements
        if chance < 0.0:
            return "plain" if tag == "early" and not is_first else tag
    return "plain"


# Seconds that the hand stays after the event; a hovering hand stays until it picks.
_DWELL = {"pick": 0.18, "put": 0.18, "hover": np.inf, "pass_by": 0.02, "touch": 0.5, "nudge": 0.35, "hinge": 1.25}
_FROM_HOVER = 0.7  # of the usual time, for the short way from a hovering hand to the object
_LONGEST_GAP = 9.7
_TRIES = 14
_TRIES_A_SURFACE = 5  # before another is drawn: else hard ones, very high or very low, would become rare
_RESTING_GAP = 0.13  # metres between the centres of two objects at rest
_LARGE_GAP = 0.24  # around trays and doors
_PUT_FROM_PICK = 0.22
_HIGHEST_GOAL = 0.96  # of the stature
_HANDING_OVER_AFTER = 1.0  # seconds after the pick
_HANDING_OVER_TAKES = 1.5
_HOVER_ABOVE = 0.03
_PASSING = (0.031, 0.044)  # metres between finger base and box when a hand passes by


def plan_recording(
    preset: Preset,
    person: Person,
    room: Room,
    n_events: int,
    rng: np.random.Generator,
    *,
    is_seated: bool = False,
    shares: Mapping[str, float] | None = None,
    provoker: np.random.Generator | None = None,
) -> Plan:
    """Plan one recording.

    Args:
        preset: Constants.
        person: Who acts.
        room: The room.
        n_events: Picks and puts to attempt; a goal that cannot be reached from anywhere is dropped.
        rng: The recording's plan generator.
        is_seated: Whether the person sits at the table (preset hot3d).
        shares: Share of the movements for each provocation; none if None.
        provoker: Generator of the provocations.
    """
    planner = _Planner(preset, person, room, rng, is_seated, shares or {}, provoker or rng)
    start = planner.base
    for _ in range(n_events):
        planner.add_event()
    items = (*planner.items, *room.bystanders)
    return Plan(preset, person, room, is_seated, start, items, tuple(planner.segments), tuple(planner.reaches))


@dataclass(eq=False, repr=False)
class _Planner:
    """The recording's fixed surroundings, the progress of its plan, and the draws that depend on both."""

    preset: Preset
    person: Person
    room: Room
    rng: np.random.Generator
    is_seated: bool
    shares: Mapping[str, float]
    provoker: np.random.Generator

    def __post_init__(self) -> None:
        self.kinds = [self.preset.objects[i] for i in self.rng.permutation(len(self.preset.objects))]
        self.reachability = Reachability(self.preset, self.person, self.room, self.rng, self.is_seated)
        # The person begins before a surface, anywhere along it.
        self.surface = self._other_surface(None)
        first = self.room.surfaces[self.surface]
        edge = self.rng.uniform(*self.preset.edge)
        lateral = 0.0 if self.is_seated else self.rng.uniform(-0.3, 0.3) * first.width
        point = first.point(float(lateral), -float(edge))
        self.base = BasePose(float(point[0]), float(point[2]), first.facing)
        self.free_from = OPENING
        self.spots: list[np.ndarray] = []
        self.items: list[Item] = []
        self.segments: list[Segment] = []
        self.reaches: list[Reach] = []
        self.holding: Reach | None = None
        self.tag = "plain"  # of the pair of events under way
        self.tagged_event = ""  # which of the two a tag of single events means: pick or put

    def add_event(self) -> None:
        """Plan the next pick or put; leaves the plan as it is when no reachable goal is found."""
        if self.holding is not None:
            self._put(self.holding)
            return
        movements = 2 if self.preset.puts else 1
        self.tag = draw_tag(self.shares, movements, not self.reaches, self.provoker) if self.shares else "plain"
        self.tagged_event = "put" if self.preset.puts and self.provoker.random() < 0.5 else "pick"
        if self.tag in EXTRA:
            self._extra(cast(Action, self.tag))
        self._pick()

    def _next_kind(self) -> ObjectKind:
        return self.kinds[len(self.items) % len(self.kinds)]

    def _pick(self) -> None:
        is_tray = self.tag == "contained"
        kind = TRAY if is_tray else self._next_kind()
        found = self._find_new(kind, TRAY_HANDLE if is_tray else None, near=self.tag in ("early", "too_near"))
        if found is None:
            return
        goal, stand, hand, motor_start = found
        self.items.append(Item(kind, goal.half_extents, goal.centre, goal.yaw))
        index = len(self.items) - 1
        if is_tray:
            # Something stands on the tray and is carried with it.
            load = self._next_kind()
            half = np.array([0.03, 0.04, 0.03])
            centre = goal.centre + turn(goal.yaw, 0.0, TRAY_LOAD) + (goal.half_extents[1] + half[1]) * UP
            self.items.append(Item(load, half, centre, goal.yaw, rides_on=index))
        if self.tag == "too_near":
            # The hand comes near the goal without a look, long before the pick.
            raised = replace(stand.grasp, wrist=stand.grasp.wrist + _HOVER_ABOVE * UP)
            hover = self._reach("hover", goal, replace(stand, grasp=raised), hand, index, motor_start)
            self._commit(hover, stand)
            self.spots.pop()
            motor_start = hover.event + float(self.provoker.uniform(3.4, 4.2))
            stand = replace(stand, segment=None)
        reach = self._reach("pick", goal, stand, hand, index, motor_start)
        self._commit(reach, stand)
        self.holding = reach if self.preset.puts else None

    def _put(self, pick: Reach) -> None:
        """Put down what was picked; keeps trying until a place is found."""
        hand = pick.hand
        held = Held(pick.centre, pick.yaw, pick.base.heading, pick.grasp)
        handing = None
        if self.tag == "hand_over":
            hand, held = 1 - pick.hand, None
            handing = pick.event + _HANDING_OVER_AFTER
            self.free_from = max(self.free_from, handing + _HANDING_OVER_TAKES)
        found = self._find_place(pick, held, hand)
        if found is None:
            return
        goal, stand, motor_start = found
        reach = self._reach("put", goal, stand, hand, pick.item, motor_start)
        self._commit(replace(reach, handed_over=handing, second_hand=pick.second_hand), stand)
        self.holding, self.tag = None, "plain"

    def _extra(self, action: Action) -> None:
        """Plan a movement that is no pick and no put, of an object that nobody carries."""
        is_door = action == "hinge"
        kind = DOOR if is_door else self._next_kind()
        found = self._find_new(kind, DOOR_HANDLE if is_door else None, near=True)
        if found is None:
            return
        goal, stand, hand, motor_start = found
        self.items.append(Item(kind, goal.half_extents, goal.centre, goal.yaw, hinged=is_door))
        reach = self._reach(action, goal, stand, hand, len(self.items) - 1, motor_start)
        if action == "pass_by":
            clearance = float(self.provoker.uniform(*_PASSING))
            grasp = kept_away(reach.grasp, self.person.body.hand, goal.centre, goal.half_extents, goal.yaw, clearance)
            reach = replace(reach, grasp=grasp)
        self._commit(reach, stand)

    def _motor_start(self) -> float:
        median, spread = self.preset.idle
        return self.free_from + float(np.clip(median * np.exp(spread * self.rng.standard_normal()), 0.25, 12.0))

    def _find_new(
        self, kind: ObjectKind, handle: np.ndarray | None, *, near: bool
    ) -> tuple[Goal, Stand, int, float] | None:
        """Draw a new object on a free, reachable spot."""
        motor_start = self._motor_start()
        surfaces = self._surface_drawer(near)
        for _ in range(_TRIES * (3 if self.preset.table_only else 1)):
            half_extents, yaw = draw_item_shape(kind, self.rng)
            surface, around = surfaces()
            place = self.room.surfaces[surface]
            if handle is not None:
                yaw = place.facing
            centre = draw_spot(place, half_extents, yaw, self.rng, around)
            if not self._is_free(centre, None, _LARGE_GAP if handle is not None else _RESTING_GAP):
                continue
            goal = Goal(surface, centre, half_extents, yaw, handle, None if handle is None else HANDLE_HALF)
            hand = self.reachability.hand_for(self.base, centre)
            stand = self.reachability.stand(self.base, self.surface, goal, hand, None, motor_start)
            if stand is not None:
                return goal, stand, hand, motor_start
        return None

    def _find_place(self, pick: Reach, held: Held | None, hand: int) -> tuple[Goal, Stand, float] | None:
        item = self.items[pick.item]
        motor_start = self._motor_start()
        surfaces = self._surface_drawer(False)
        for attempt in range(4 * _TRIES):
            surface, around = surfaces()
            centre = draw_spot(self.room.surfaces[surface], item.half_extents, 0.0, self.rng, around)
            if self.tag == "same_place" and attempt < _TRIES:
                surface = pick.surface
                centre = pick.centre + np.array([1.0, 0.0, 1.0]) * self.rng.uniform(-0.018, 0.018, 3)
            elif not self._is_free(centre, pick.centre, _LARGE_GAP if item.kind is TRAY else _RESTING_GAP):
                continue
            goal = Goal(surface, centre, item.half_extents, 0.0 if held is not None else pick.yaw)
            stand = self.reachability.stand(self.base, self.surface, goal, hand, held, motor_start)
            if stand is not None:
                return goal, stand, motor_start
        return None

    def _surface_drawer(self, near: bool) -> Callable[[], tuple[int, tuple[float, float] | None]]:
        """Draws surface and lateral spread again and again, deciding only once whether to stay near."""
        stays = self.preset.table_only or near or self.rng.random() < self.preset.same_surface
        is_near = self.rng.random() < self.preset.near
        tries = 0
        chosen = self.surface

        def draw() -> tuple[int, tuple[float, float] | None]:
            nonlocal tries, chosen
            if not stays and tries % _TRIES_A_SURFACE == 0:
                chosen = self._other_surface(self.surface)
            tries += 1
            if not is_near or chosen != self.surface or not self.spots:
                return chosen, None
            place = self.room.surfaces[chosen]
            return chosen, (float((self.spots[-1] - place.edge_centre) @ place.left), self.preset.spread)

        return draw

    def _other_surface(self, current: int | None) -> int:
        weights = np.array([surface.weight for surface in self.room.surfaces])
        if current is not None and len(weights) > 1:
            weights[current] = 0.0
        return int(self.rng.choice(len(weights), p=weights / weights.sum()))

    def _is_free(self, centre: np.ndarray, picked_from: np.ndarray | None, gap: float) -> bool:
        """Return True where a spot is far enough from recent ones, its own pick, and everything that stands there."""
        if any(np.linalg.norm(centre - spot) < self.preset.spot_spacing for spot in self.spots[-4:]):
            return False
        if picked_from is not None and np.linalg.norm(centre - picked_from) < _PUT_FROM_PICK:
            return False
        standing = [*self.spots, *(item.position for item in (*self.items, *self.room.bystanders))]
        if any(np.linalg.norm(centre - other) < gap for other in standing):
            return False
        return bool(centre[1] < _HIGHEST_GOAL * self.person.body.stature)

    def _reach(self, action: Action, goal: Goal, stand: Stand, hand: int, item: int, motor_start: float) -> Reach:
        """Draw the timing of a movement: which hand does what to which object from where, and from when on."""
        tag = self._tag_of(action)
        arrival = motor_start if stand.segment is None else stand.segment.arrival
        reach_start = max(motor_start, arrival - float(self.rng.uniform(0.05, 0.30)))
        # Peak speeds grow with the way of the hand, and so do, less, the times that people take (Jeannerod 1984).
        least, a_metre = self.person.manner.reach_time
        usual = least + a_metre * self._way_of_hand(action, stand, hand)
        varied = (0.85 + 0.30 * self.rng.random()) * self.person.habits.reach_time
        length = varied * usual + self.rng.uniform(0.03, 0.12)
        from_hover = tag == "too_near" and action == "pick"
        event = reach_start + float(length) * (_FROM_HOVER if from_hover else 1.0)
        what = (len(self.reaches), action, tag, item, hand)
        where = (goal.surface, goal.centre, stand.yaw, world_half_extents(goal.half_extents, stand.yaw))
        posture = (stand.base, stand.grasp, stand.posture)
        times = (motor_start, reach_start, event - 0.04, event, _DWELL[action])
        changed = self._draw_provocation(action, tag, goal, stand, event)
        return Reach(*what, *where, *posture, *times, action == "pick" and self.preset.puts, **changed)

    def _way_of_hand(self, action: Action, stand: Stand, hand: int) -> float:
        """Return the distance from where a hand hangs, works or carries to where it is to reach, metres."""
        stature = self.person.body.stature
        pelvis_height = seated_pelvis_height(self.person.body) if self.is_seated else None
        pose = self.preset.work_pose or (0.0, -self.person.body.arm / stature, 0.0)
        if action == "put":
            pose = self.preset.carry_pose
        side = 1.0 if hand == 0 else -1.0
        shoulder = shoulder_in_posture(
            Reacher(self.person, stand.base, hand, pelvis_height), Posture(0.0, 0.0, 0.0, 0.0)
        )
        before = shoulder + turn(stand.base.heading, 0.0, stature * np.array([side * pose[0], pose[1], pose[2]]))
        return float(np.linalg.norm(stand.grasp.wrist - before))

    def _tag_of(self, action: Action) -> str:
        """Return the tag that a movement itself carries."""
        if action == "hover":
            return "too_near"
        if action in EXTRA:
            return action
        if self.tag in ("too_near", "early"):
            return self.tag if action == "pick" else "plain"
        is_tagged = self.tag in _OF_PAIR or (self.tag in _OF_EVENT and action == self.tagged_event)
        return self.tag if is_tagged else "plain"

    def _draw_provocation(self, action: Action, tag: str, goal: Goal, stand: Stand, event: float) -> dict[str, Any]:
        """Draw the fields of a reach that its provocation changes."""
        draw = self.provoker.uniform
        if action == "nudge":
            away = goal.centre - stand.grasp.wrist
            away[1] = 0.0
            return {"slide": float(draw(0.008, 0.018)) * away / np.linalg.norm(away)}
        if action == "hinge":
            return {"opening": float(draw(0.55, 0.8))}
        if tag == "two_handed":
            return {"second_hand": float(draw(0.10, 0.16))}
        if tag == "too_near" and action == "pick":
            return {"gap": float(draw(0.42, 0.55))}
        if tag == "early":
            return {"gap": min(event - float(draw(0.6, 1.7)), _LONGEST_GAP)}
        if tag == "lost":
            before = float(draw(0.1, 0.5))
            after = float(draw(0.2, 0.5))
            return {"lost": (event - before, event + after)}
        return {}

    def _commit(self, reach: Reach, stand: Stand) -> None:
        self.reaches.append(reach)
        self.spots.append(reach.centre)
        if stand.segment is not None:
            self.segments.append(stand.segment)
        self.base, self.surface = stand.base, reach.surface
        stays = 0.0 if np.isinf(reach.dwell) else max(reach.dwell - 0.18, 0.0)
        self.free_from = reach.event + stays + float(self.rng.uniform(0.7, 1.0))
