"""Decides what happens in a recording: which objects go where, from which standing place, with which hand, and when.

Source: ``methods/synthetic-recordings.md`` sections 1, 3, 4 and 6. Everything random about events is decided here;
the gaze is planned in :mod:`gaze_plan`, the motion follows without further choices.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePose, Segment, plan_segment
from prbench.synthetic.people.grasp import (
    Grasp,
    Posture,
    draw_grasp_numbers,
    shoulder_in_posture,
    solve_posture,
    take_hold,
)
from prbench.synthetic.people.person import Person
from prbench.synthetic.people.presets import Preset
from prbench.synthetic.people.trunk import seated_pelvis_height
from prbench.synthetic.people.world import Item, Room, Surface, draw_item_shape, draw_spot, world_half_extents

OPENING = 2.5  # seconds of standing before anything happens
_TRIES = 14
_WITHIN_REACH = 0.92
_STEP_NEARER_ABOVE = 0.905
_RESTING_GAP = 0.13  # metres between the centres of two objects at rest


@dataclass(frozen=True)
class Reach:
    """One purposeful movement of a hand: a pick, a put, or a provocation that is neither."""

    number: int
    action: str
    """``pick``, ``put``, or the tag of a movement that is no event."""
    tag: str
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
    n_handled: int
    segments: tuple[Segment, ...]
    reaches: tuple[Reach, ...]

    @property
    def pelvis_height(self) -> float | None:
        """Of a seated person; None when standing."""
        return seated_pelvis_height(self.person.body) if self.is_seated else None


@dataclass
class _State:
    """Where the plan has got to."""

    base: BasePose
    surface: int
    free_from: float
    spots: list[np.ndarray] = field(default_factory=list)
    items: list[Item] = field(default_factory=list)
    resting: list[np.ndarray] = field(default_factory=list)
    segments: list[Segment] = field(default_factory=list)
    reaches: list[Reach] = field(default_factory=list)
    holding: Reach | None = None


@dataclass(frozen=True)
class _Candidate:
    """A goal that can be reached, and from where."""

    surface: int
    centre: np.ndarray
    yaw: float
    half_world: np.ndarray
    hand: int
    base: BasePose
    segment: Segment | None
    grasp: Grasp
    posture: Posture


def plan_recording(
    preset: Preset, person: Person, room: Room, n_events: int, rng: np.random.Generator, *, is_seated: bool = False
) -> Plan:
    """Plan one recording.

    Args:
        preset: Constants.
        person: Who acts.
        room: Where.
        n_events: Picks and puts to attempt; a goal that cannot be reached from anywhere is dropped.
        rng: The recording's plan generator.
        is_seated: Whether the person sits at the table (preset hot3d).
    """
    planner = _Planner(preset, person, room, rng, is_seated)
    start = planner.first_place()
    state = _State(start, planner.start_surface, OPENING)
    for _ in range(n_events):
        planner.add_event(state)
    items = (*state.items, *room.bystanders)
    return Plan(
        preset, person, room, is_seated, start, items, len(state.items), tuple(state.segments), tuple(state.reaches)
    )


class _Planner:
    """The recording's fixed surroundings, and the draws that depend on them."""

    def __init__(self, preset: Preset, person: Person, room: Room, rng: np.random.Generator, is_seated: bool) -> None:
        self.preset, self.person, self.room, self.rng, self.is_seated = preset, person, room, rng, is_seated
        self.weights = np.array([surface.weight for surface in room.surfaces])
        self.kinds = [preset.objects[i] for i in rng.permutation(len(preset.objects))]
        self.start_surface = self._other_surface(None)
        self.pelvis_height = seated_pelvis_height(person.body) if is_seated else None

    def first_place(self) -> BasePose:
        """Standing before a surface, anywhere along it."""
        surface = self.room.surfaces[self.start_surface]
        edge = self.rng.uniform(*self.preset.edge)
        lateral = 0.0 if self.is_seated else self.rng.uniform(-0.3, 0.3) * surface.width
        point = surface.point(float(lateral), -float(edge))
        return BasePose(float(point[0]), float(point[2]), surface.facing)

    def add_event(self, state: _State) -> None:
        """Plan the next pick or put; leaves the state as it is when no reachable goal is found."""
        median, spread = self.preset.idle
        idle = float(np.clip(median * np.exp(spread * self.rng.standard_normal()), 0.25, 12.0))
        motor_start = state.free_from + idle
        picking = state.holding is None or not self.preset.puts
        found = self._find(state, motor_start, None if picking else state.holding)
        if found is None:
            return
        candidate, item = found
        number = len(state.reaches)
        index = len(state.items) if item is not None else state.holding.item if state.holding else 0
        if item is not None:
            state.items.append(item)
        arrival = motor_start if candidate.segment is None else candidate.segment.arrival
        reach_start = max(motor_start, arrival - float(self.rng.uniform(0.15, 0.45)))
        length = (0.62 + 0.35 * self.rng.random()) * self.person.habits.reach_time + self.rng.uniform(0.03, 0.12)
        event = reach_start + float(length)
        reach = Reach(
            number=number,
            action="pick" if picking else "put",
            tag="plain",
            item=index,
            hand=candidate.hand,
            surface=candidate.surface,
            centre=candidate.centre,
            yaw=candidate.yaw,
            half_world=candidate.half_world,
            base=candidate.base,
            grasp=candidate.grasp,
            posture=candidate.posture,
            motor_start=motor_start,
            reach_start=reach_start,
            contact=event - 0.04,
            event=event,
        )
        state.reaches.append(reach)
        state.spots.append(candidate.centre)
        state.resting.append(candidate.centre)
        if candidate.segment is not None:
            state.segments.append(candidate.segment)
        state.base, state.surface = candidate.base, candidate.surface
        state.free_from = event + float(self.rng.uniform(0.7, 1.0))
        state.holding = reach if picking and self.preset.puts else None

    def _find(self, state: _State, motor_start: float, held: Reach | None) -> tuple[_Candidate, Item | None] | None:
        kind = self.kinds[len(state.items) % len(self.kinds)]
        stays = self.preset.table_only or self.rng.random() < self.preset.same_surface
        is_near = self.rng.random() < self.preset.near
        for _ in range(_TRIES if held is None else 4 * _TRIES):
            if held is None:
                half_extents, yaw = draw_item_shape(kind, self.rng)
            else:
                half_extents, yaw = state.items[held.item].half_extents, 0.0
            surface = state.surface if stays else self._other_surface(state.surface)
            around = self._around(state, surface) if is_near else None
            centre = draw_spot(self.room.surfaces[surface], half_extents, yaw, self.rng, around)
            if not self._is_free(state, centre, held):
                continue
            candidate = self._reach_it(state, motor_start, surface, centre, half_extents, yaw, held)
            if candidate is None:
                continue
            item = Item(kind, half_extents, centre, yaw) if held is None else None
            return candidate, item
        return None

    def _other_surface(self, current: int | None) -> int:
        weights = self.weights.copy()
        if current is not None and len(weights) > 1:
            weights[current] = 0.0
        return int(self.rng.choice(len(weights), p=weights / weights.sum()))

    def _around(self, state: _State, surface: int) -> tuple[float, float] | None:
        """Around the previous spot, when that is on the same surface."""
        if surface != state.surface or not state.spots:
            return None
        place = self.room.surfaces[surface]
        return float((state.spots[-1] - place.edge_centre) @ place.left), self.preset.spread

    def _is_free(self, state: _State, centre: np.ndarray, held: Reach | None) -> bool:
        recent = state.spots[-4:]
        if any(np.linalg.norm(centre - spot) < self.preset.spot_spacing for spot in recent):
            return False
        if held is not None and np.linalg.norm(centre - held.centre) < 0.22:
            return False
        standing = [*state.resting, *(item.position for item in self.room.bystanders)]
        if any(np.linalg.norm(centre - other) < _RESTING_GAP for other in standing):
            return False
        return bool(centre[1] < 0.96 * self.person.body.stature)

    def _reach_it(
        self,
        state: _State,
        motor_start: float,
        surface: int,
        centre: np.ndarray,
        half_extents: np.ndarray,
        yaw: float,
        held: Reach | None,
    ) -> _Candidate | None:
        hand = self._hand(state.base, centre) if held is None else held.hand
        number = draw_grasp_numbers(self.preset, self.rng)
        for place in self._places(state, surface, centre, hand):
            segment = plan_segment(self.person.habits, self.preset.speed, state.base, place, motor_start)
            base = state.base if segment is None else segment.goal
            turned = 0.0 if held is None else base.heading - held.base.heading
            box_yaw = yaw if held is None else held.yaw + turned
            grasp, posture = self._hold(base, hand, centre, half_extents, box_yaw, number, held, turned)
            limit = _STEP_NEARER_ABOVE if place is not state.base else _WITHIN_REACH
            too_near = np.hypot(centre[0] - base.x, centre[2] - base.z) < 0.34
            if too_near and not self.is_seated:
                return None
            if posture.extension <= limit:
                half_world = world_half_extents(half_extents, box_yaw)
                return _Candidate(surface, centre, box_yaw, half_world, hand, base, segment, grasp, posture)
        return None

    def _hold(
        self,
        base: BasePose,
        hand: int,
        centre: np.ndarray,
        half_extents: np.ndarray,
        yaw: float,
        number: float,
        held: Reach | None,
        turned: float,
    ) -> tuple[Grasp, Posture]:
        """Grasp and posture depend on one another through the shoulder: two rounds settle them."""
        if held is not None:
            grasp = held.grasp.moved(held.centre, centre, turned)
            return grasp, solve_posture(self.person, base, hand, grasp.wrist, self.pelvis_height)
        posture = Posture(0.0, 0.0, 0.0, 0.0)
        for _ in range(2):
            shoulder = shoulder_in_posture(self.person, base, hand, posture, self.pelvis_height)
            grasp = take_hold(self.preset, self.person.body, shoulder, centre, half_extents, yaw, number)
            posture = solve_posture(self.person, base, hand, grasp.wrist, self.pelvis_height)
        return grasp, posture

    def _hand(self, base: BasePose, centre: np.ndarray) -> int:
        """The side of the goal with p = .75, else the preferred hand."""
        preferred = int(self.person.habits.right_handed)
        if self.rng.random() >= 0.75:
            return preferred
        return int((centre - base.point) @ base.left < 0.0)

    def _places(self, state: _State, surface: int, centre: np.ndarray, hand: int) -> list[BasePose]:
        """Standing places to try in turn: where one stands, the good place, then nearer ones."""
        if self.is_seated:
            return [state.base]
        front = self.room.surfaces[surface]
        if self.preset.table_only:
            return self._table_places(state, front, centre, hand)
        places = [state.base] if surface == state.surface and self._feet_may_stay(state.base, centre) else []
        good = self._standing_place(front, centre, hand)
        return [*places, *(self._nearer(good, front, 0.06 * number, centre) for number in range(5))]

    def _feet_may_stay(self, base: BasePose, centre: np.ndarray) -> bool:
        offset = centre - base.point
        offset[1] = 0.0
        lateral, ahead = abs(float(offset @ base.left)), float(offset @ base.forward)
        return lateral <= 0.38 and ahead > 0.2 and np.linalg.norm(offset) <= 0.31 * self.person.body.stature + 0.30

    def _standing_place(self, front: Surface, centre: np.ndarray, hand: int) -> BasePose:
        aside = float(self.rng.normal(0.12, 0.06)) * (1.0 if hand == 1 else -1.0)
        lateral = float((centre - front.edge_centre) @ front.left) + aside
        point = front.point(lateral, -float(self.rng.uniform(*self.preset.edge)))
        half_x, half_z = self.room.floor[0] / 2.0 - 0.15, self.room.floor[1] / 2.0 - 0.15
        point[0], point[2] = np.clip(point[0], -half_x, half_x), np.clip(point[2], -half_z, half_z)
        heading = front.facing + float(np.deg2rad(self.rng.uniform(-8.0, 8.0)))
        return BasePose(float(point[0]), float(point[2]), heading)

    def _nearer(self, place: BasePose, front: Surface, by: float, centre: np.ndarray) -> BasePose:
        towards = centre - place.point
        towards[1] = 0.0
        step = towards / np.linalg.norm(towards) * by
        return replace(place, x=place.x + float(step[0]), z=place.z + float(step[2]))

    def _table_places(self, state: _State, front: Surface, centre: np.ndarray, hand: int) -> list[BasePose]:
        """Along one table people shift most of the way to the good place, and lean for the rest."""
        good = self._standing_place(front, centre, hand)
        back = float(self.rng.uniform(-0.03, 0.08)) * front.normal
        place = BasePose(
            state.base.x + 0.75 * (good.x - state.base.x) + float(back[0]),
            state.base.z + 0.75 * (good.z - state.base.z) + float(back[2]),
            front.facing + float(np.deg2rad(4.0)) * float(self.rng.standard_normal()),
        )
        distance = np.hypot(centre[0] - place.x, centre[2] - place.z)
        return [place] if distance <= 0.40 * self.person.body.stature else []
