"""Decides what happens in a recording: which objects go where, from which place, with which hand, and when.

Sources: docs/specification/synthetic-recordings.md#world, docs/specification/synthetic-recordings.md#event-truth and
docs/specification/synthetic-recordings.md#provocations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from prbench.synthetic.people.base import BasePose, Segment
from prbench.synthetic.people.grasp import kept_away
from prbench.synthetic.people.kinematics import UP, turn
from prbench.synthetic.people.person import Person
from prbench.synthetic.people.places import Goal, Held, Reachability, Stand
from prbench.synthetic.people.plan import (
    DOOR,
    DOOR_HANDLE,
    EXTRA,
    HANDLE_HALF,
    OPENING,
    TRAY,
    TRAY_HANDLE,
    TRAY_LOAD,
    Action,
    Movement,
    Pair,
    Plan,
    Reach,
    draw_tag,
    make_reach,
    tag_of,
)
from prbench.synthetic.people.presets import ObjectKind, Preset
from prbench.synthetic.people.world import Item, Room, draw_item_shape, draw_spot

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


@dataclass
class _State:
    """Progress of the plan."""

    base: BasePose
    surface: int
    free_from: float = OPENING
    spots: list[np.ndarray] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    segments: list[Segment] = field(default_factory=list)
    reaches: list[Reach] = field(default_factory=list)
    holding: Reach | None = None
    tag: str = "plain"
    """Of the pair of events under way."""
    tagged_event: str = ""
    """Which of the two a tag of single events means: pick or put."""


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
        room: Where.
        n_events: Picks and puts to attempt; a goal that cannot be reached from anywhere is dropped.
        rng: The recording's plan generator.
        is_seated: Whether the person sits at the table (preset hot3d).
        shares: Of the movements, for each provocation; none if None.
        provoker: Generator of the provocations.
    """
    planner = _Planner(preset, person, room, rng, is_seated, shares or {}, provoker or rng)
    start, surface = planner.first_place()
    state = _State(start, surface)
    for _ in range(n_events):
        planner.add_event(state)
    items = (*state.items, *room.bystanders)
    return Plan(preset, person, room, is_seated, start, items, tuple(state.segments), tuple(state.reaches))


class _Planner:
    """The recording's fixed surroundings, and the draws that depend on them."""

    def __init__(
        self,
        preset: Preset,
        person: Person,
        room: Room,
        rng: np.random.Generator,
        is_seated: bool,
        shares: Mapping[str, float],
        provoker: np.random.Generator,
    ) -> None:
        self.preset = preset
        self.person = person
        self.room = room
        self.rng = rng
        self.is_seated = is_seated
        self.shares = shares
        self.provoker = provoker
        self.weights = np.array([surface.weight for surface in room.surfaces])
        self.kinds = [preset.objects[i] for i in rng.permutation(len(preset.objects))]
        self.reachability = Reachability(preset, person, room, rng, is_seated)

    def first_place(self) -> tuple[BasePose, int]:
        """Draw a place before a surface, anywhere along it."""
        number = self._other_surface(None)
        surface = self.room.surfaces[number]
        edge = self.rng.uniform(*self.preset.edge)
        lateral = 0.0 if self.is_seated else self.rng.uniform(-0.3, 0.3) * surface.width
        point = surface.point(float(lateral), -float(edge))
        return BasePose(float(point[0]), float(point[2]), surface.facing), number

    def add_event(self, state: _State) -> None:
        """Plan the next pick or put; leaves the state as it is when no reachable goal is found."""
        if state.holding is not None:
            self._put(state, state.holding)
            return
        movements = 2 if self.preset.puts else 1
        state.tag = draw_tag(self.shares, movements, not state.reaches, self.provoker) if self.shares else "plain"
        state.tagged_event = "put" if self.preset.puts and self.provoker.random() < 0.5 else "pick"
        if state.tag in EXTRA:
            self._extra(state, state.tag)
        self._pick(state)

    def _pick(self, state: _State) -> None:
        kind = TRAY if state.tag == "contained" else self.kinds[len(state.items) % len(self.kinds)]
        found = self._find_new(
            state, kind, TRAY_HANDLE if kind is TRAY else None, near=state.tag in ("early", "too_near")
        )
        if found is None:
            return
        goal, stand, hand, motor_start = found
        state.items.append(Item(kind, goal.half_extents, goal.centre, goal.yaw))
        index = len(state.items) - 1
        if kind is TRAY:
            self._load_tray(state, goal, index)
        if state.tag == "too_near":
            motor_start = self._hover(state, goal, stand, hand, index, motor_start)
            stand = replace(stand, segment=None)
        reach = self._reach(state, "pick", goal, stand, hand, index, motor_start)
        self._commit(state, reach, stand)
        state.holding = reach if self.preset.puts else None

    def _put(self, state: _State, pick: Reach) -> None:
        """Put down what was picked; keeps trying until a place is found."""
        item = state.items[pick.item]
        hand = 1 - pick.hand if state.tag == "hand_over" else pick.hand
        held = None if state.tag == "hand_over" else Held(pick.centre, pick.yaw, pick.base.heading, pick.grasp)
        handing = pick.event + _HANDING_OVER_AFTER if state.tag == "hand_over" else None
        if handing is not None:
            state.free_from = max(state.free_from, handing + _HANDING_OVER_TAKES)
        found = self._find_place(state, item, pick, held, hand)
        if found is None:
            return
        goal, stand, motor_start = found
        reach = self._reach(state, "put", goal, stand, hand, pick.item, motor_start)
        twist = replace(reach.twist, handed_over=handing, second_hand=pick.twist.second_hand)
        self._commit(state, replace(reach, twist=twist), stand)
        state.holding, state.tag = None, "plain"

    def _extra(self, state: _State, tag: str) -> None:
        """Plan a movement that is no pick and no put, of an object that nobody carries."""
        kind = DOOR if tag == "hinge" else self.kinds[len(state.items) % len(self.kinds)]
        found = self._find_new(state, kind, DOOR_HANDLE if tag == "hinge" else None, near=True)
        if found is None:
            return
        goal, stand, hand, motor_start = found
        state.items.append(Item(kind, goal.half_extents, goal.centre, goal.yaw, hinged=tag == "hinge"))
        reach = self._reach(state, cast(Action, tag), goal, stand, hand, len(state.items) - 1, motor_start)
        if tag == "pass_by":
            clearance = float(self.provoker.uniform(*_PASSING))
            grasp = kept_away(reach.grasp, self.person.body.hand, goal.centre, goal.half_extents, goal.yaw, clearance)
            reach = replace(reach, grasp=grasp)
        self._commit(state, reach, stand)

    def _hover(self, state: _State, goal: Goal, stand: Stand, hand: int, item: int, motor_start: float) -> float:
        """Bring the hand near a goal without looking, long before the pick; returns when the pick may start."""
        raised = replace(stand.grasp, wrist=stand.grasp.wrist + _HOVER_ABOVE * UP)
        hover = self._reach(state, "hover", goal, replace(stand, grasp=raised), hand, item, motor_start)
        self._commit(state, hover, stand)
        state.spots.pop()
        return hover.event + float(self.provoker.uniform(3.4, 4.2))

    def _load_tray(self, state: _State, goal: Goal, tray: int) -> None:
        kind = self.kinds[len(state.items) % len(self.kinds)]
        half = np.array([0.03, 0.04, 0.03])
        centre = goal.centre + turn(goal.yaw, 0.0, TRAY_LOAD) + (goal.half_extents[1] + half[1]) * UP
        state.items.append(Item(kind, half, centre, goal.yaw, rides_on=tray))

    def _motor_start(self, state: _State) -> float:
        median, spread = self.preset.idle
        idle = float(np.clip(median * np.exp(spread * self.rng.standard_normal()), 0.25, 12.0))
        return state.free_from + idle

    def _find_new(
        self, state: _State, kind: ObjectKind, handle: np.ndarray | None, *, near: bool
    ) -> tuple[Goal, Stand, int, float] | None:
        """Draw a new object on a free, reachable spot."""
        motor_start = self._motor_start(state)
        surfaces = self._surface_drawer(state, near)
        for _ in range(_TRIES * (3 if self.preset.table_only else 1)):
            half_extents, yaw = draw_item_shape(kind, self.rng)
            surface, around = surfaces()
            place = self.room.surfaces[surface]
            if handle is not None:
                yaw = place.facing
            centre = draw_spot(place, half_extents, yaw, self.rng, around)
            if not self._is_free(state, centre, None, _LARGE_GAP if handle is not None else _RESTING_GAP):
                continue
            goal = Goal(surface, centre, half_extents, yaw, handle, None if handle is None else HANDLE_HALF)
            hand = self.reachability.hand_for(state.base, centre)
            stand = self.reachability.stand(state.base, state.surface, goal, hand, None, motor_start, stay=False)
            if stand is not None:
                return goal, stand, hand, motor_start
        return None

    def _find_place(
        self, state: _State, item: Item, pick: Reach, held: Held | None, hand: int
    ) -> tuple[Goal, Stand, float] | None:
        motor_start = self._motor_start(state)
        surfaces = self._surface_drawer(state, False)
        for attempt in range(4 * _TRIES):
            surface, around = surfaces()
            centre = draw_spot(self.room.surfaces[surface], item.half_extents, 0.0, self.rng, around)
            back_again = state.tag == "same_place" and attempt < _TRIES
            if back_again:
                surface = pick.surface
                centre = pick.centre + np.array([1.0, 0.0, 1.0]) * self.rng.uniform(-0.018, 0.018, 3)
            elif not self._is_free(state, centre, pick.centre, _LARGE_GAP if item.kind is TRAY else _RESTING_GAP):
                continue
            goal = Goal(surface, centre, item.half_extents, 0.0 if held is not None else pick.yaw)
            stand = self.reachability.stand(state.base, state.surface, goal, hand, held, motor_start, stay=False)
            if stand is not None:
                return goal, stand, motor_start
        return None

    def _surface_drawer(self, state: _State, near: bool) -> Callable[[], tuple[int, tuple[float, float] | None]]:
        """Draws surface and lateral spread again and again, deciding only once whether to stay near."""
        stays = self.preset.table_only or near or self.rng.random() < self.preset.same_surface
        is_near = self.rng.random() < self.preset.near

        tries = 0
        chosen = state.surface

        def draw() -> tuple[int, tuple[float, float] | None]:
            nonlocal tries, chosen
            if not stays and tries % _TRIES_A_SURFACE == 0:
                chosen = self._other_surface(state.surface)
            tries += 1
            if not is_near or chosen != state.surface or not state.spots:
                return chosen, None
            place = self.room.surfaces[chosen]
            return chosen, (float((state.spots[-1] - place.edge_centre) @ place.left), self.preset.spread)

        return draw

    def _other_surface(self, current: int | None) -> int:
        weights = self.weights.copy()
        if current is not None and len(weights) > 1:
            weights[current] = 0.0
        return int(self.rng.choice(len(weights), p=weights / weights.sum()))

    def _is_free(self, state: _State, centre: np.ndarray, picked_from: np.ndarray | None, gap: float) -> bool:
        """Return True where a spot is far enough from recent ones, its own pick, and everything that stands there."""
        if any(np.linalg.norm(centre - spot) < self.preset.spot_spacing for spot in state.spots[-4:]):
            return False
        if picked_from is not None and np.linalg.norm(centre - picked_from) < _PUT_FROM_PICK:
            return False
        standing = [*state.spots, *(item.position for item in (*state.items, *self.room.bystanders))]
        if any(np.linalg.norm(centre - other) < gap for other in standing):
            return False
        return bool(centre[1] < _HIGHEST_GOAL * self.person.body.stature)

    def _reach(
        self,
        state: _State,
        action: Action,
        goal: Goal,
        stand: Stand,
        hand: int,
        item: int,
        motor_start: float,
    ) -> Reach:
        pair = Pair(state.tag, state.tagged_event)
        movement = Movement(len(state.reaches), action, tag_of(pair, action), item, hand, motor_start)
        return make_reach(self.preset, self.person, movement, goal, stand, self.rng, self.provoker)

    def _commit(self, state: _State, reach: Reach, stand: Stand) -> None:
        state.reaches.append(reach)
        state.spots.append(reach.centre)
        if stand.segment is not None:
            state.segments.append(stand.segment)
        state.base, state.surface = stand.base, reach.surface
        stays = 0.0 if np.isinf(reach.dwell) else max(reach.dwell - 0.18, 0.0)
        state.free_from = reach.event + stays + float(self.rng.uniform(0.7, 1.0))
