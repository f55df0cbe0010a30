"""Grasps: the hand on a box, and the trunk that leans and crouches for it.

Source: docs/specification/synthetic-recordings.md#reaching-and-holding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people import person as people
from prbench.synthetic.people.kinematics import UP, frame_of_bone, orthogonal_unit, turn, unit, wrap
from prbench.synthetic.people.person import Body, Person, Preset
from prbench.synthetic.people.walking import BasePose, Segment, plan_segment
from prbench.synthetic.people.world import Room, Surface

Vector = Float[np.ndarray, "3"]  # metres

_LEANS = np.deg2rad(np.linspace(0.0, 70.0, 15))
_CROUCHES = np.linspace(0.0, 0.5, 14)
_HAND_SLOPE = np.deg2rad(40.0)
_SHOULDER_FORWARD = np.deg2rad(9.0)


@dataclass(frozen=True)
class Grasp:
    """Place of the wrist and turn of the hand at the moment of the event.

    Attributes:
        hand: World from hand; y from wrist to finger base.
    """

    wrist: Vector
    hand: Float[np.ndarray, "3 3"]


@dataclass(frozen=True)
class Posture:
    """Lean and crouch of the trunk for a reach.

    Attributes:
        crouch: Share of the leg.
        chest_turn: Chest against the heading, radians.
        extension: Shoulder to wrist over arm length; above about .92 the goal is out of reach.
    """

    lean: float
    crouch: float
    chest_turn: float
    extension: float


def take_hold(
    preset: Preset, body: Body, shoulder: Vector, centre: Vector, half_extents: Vector, yaw: float, number: float
) -> Grasp:
    """Return the grasp of a box by the hand of a given shoulder."""
    towards = unit(shoulder - centre)
    towards[1] = max(towards[1], 0.02) * 0.8
    towards = unit(towards)
    backwards = towards * np.cos(_HAND_SLOPE) + orthogonal_unit(UP, towards) * np.sin(_HAND_SLOPE)
    if preset.grasp == "fingertips":
        in_box = np.abs(turn(-yaw, 0.0, towards))
        away = 1.0 / float(np.max(in_box / half_extents)) + number
    elif preset.grasp == "wrapped":
        sideways = body.hand * np.sin(_HAND_SLOPE)
        away = np.sqrt(max(number**2 - sideways**2, 0.0)) - body.hand * np.cos(_HAND_SLOPE)
    else:
        away = -body.hand
        backwards = towards
    wrist = centre + away * towards + body.hand * backwards
    return Grasp(wrist, frame_of_bone(-backwards, np.cross(UP, -backwards)))


def kept_away(
    grasp: Grasp, hand_length: float, centre: Vector, half_extents: Vector, yaw: float, clearance: float
) -> Grasp:
    """Draw the hand back along itself until its finger base is ``clearance`` metres from the box."""
    backwards = -grasp.hand[:, 1]
    wrists = grasp.wrist + np.linspace(0.0, 0.25, 251)[:, None] * backwards
    in_box = turn(-yaw, 0.0, wrists - hand_length * backwards - centre)
    distance = np.linalg.norm(np.maximum(np.abs(in_box) - half_extents, 0.0), axis=-1)
    return Grasp(wrists[int(np.abs(distance - clearance).argmin())], grasp.hand)


@dataclass(frozen=True)
class Reacher:
    """Who reaches, from where, and with which hand: 0 left, 1 right.

    Attributes:
        pelvis_height: Given for a seated person, who leans only.
    """

    person: Person
    base: BasePose
    hand: int
    pelvis_height: float | None = None


def shoulder_in_posture(who: Reacher, posture: Posture) -> Vector:
    """Return where the reaching shoulder is in a posture."""
    return _shoulders(who, np.array([posture.lean]), np.array([posture.crouch]), posture.chest_turn)[0]


def solve_posture(who: Reacher, wrist: Vector, offset: np.ndarray | None = None) -> Posture:
    """Choose lean and crouch for a wrist target on a grid of 15 x 14 postures.

    Args:
        who: Who reaches, from where.
        wrist: Target, world frame.
        offset: True minus planned shoulder position, from an earlier pass.
    """
    base = who.base
    bearing = wrap(np.arctan2(wrist[0] - base.x, wrist[2] - base.z) - base.heading)
    chest = 0.5 * float(np.clip(bearing, -1.4, 1.4)) + (_SHOULDER_FORWARD if who.hand == 1 else -_SHOULDER_FORWARD)
    crouches = _CROUCHES if who.pelvis_height is None else _CROUCHES[:1]
    lean, crouch = (grid.ravel() for grid in np.meshgrid(_LEANS, crouches, indexing="ij"))
    shoulders = _shoulders(who, lean, crouch, chest)
    if offset is not None:
        shoulders = shoulders + offset
    extension = np.linalg.norm(wrist - shoulders, axis=-1) / who.person.body.arm
    disliked_crouch, disliked_lean = who.person.manner.bends
    cost = (
        (crouch / disliked_crouch) ** 2
        + (lean / disliked_lean) ** 2
        + 40.0 * np.maximum(0.0, extension - 0.88)
        + 4.0 * np.maximum(0.0, 0.5 - extension) ** 2
    )
    best = int(cost.argmin())
    return Posture(float(lean[best]), float(crouch[best]), chest, float(extension[best]))


def pelvis_setback(body: Body, lean: np.ndarray, crouch: np.ndarray) -> np.ndarray:
    """Return how far the pelvis moves back when the trunk leans or the knees bend, metres."""
    return 0.05 * body.stature * np.sin(lean) + 0.06 * crouch


def _shoulders(who: Reacher, lean: np.ndarray, crouch: np.ndarray, chest_turn: float) -> np.ndarray:
    body = who.person.body
    base = who.base
    if who.pelvis_height is None:
        height = people.standing_pelvis_height(body) - crouch * body.leg - 0.02 * lean
    else:
        height = np.full(lean.shape, who.pelvis_height)
    pelvis = base.point - pelvis_setback(body, lean, crouch)[:, None] * base.forward
    pelvis[:, 1] = height
    turned = (base.heading + 0.3 * chest_turn, base.heading + chest_turn)
    return people.pose_trunk(body, who.person.habits.stoop, pelvis, *turned, lean).shoulders[who.hand]


_WITHIN_REACH = 0.92  # of the arm's length
_STEP_NEARER_ABOVE = 0.905  # of new places a little more is asked: one that is barely enough is left for a nearer one
_STEP = 0.06  # metres between two places that are tried
_DEEP_BEND = np.deg2rad(57.0)  # people step nearer rather than bend like this for a high goal
_LOW_GOAL = 0.60
_NEAREST = 0.34  # metres; nearer, the wrist would pass through the shoulder
_WALL_CLEARANCE = 0.15


@dataclass(frozen=True)
class Goal:
    """A box to be held, at rest, and where on it.

    Attributes:
        handle: Centre of the part that is held, in the object's frame; None: the whole box.
    """

    surface: int
    centre: Vector
    half_extents: Vector
    yaw: float
    handle: Vector | None = None
    handle_half: Vector | None = None


@dataclass(frozen=True)
class Stand:
    """A place from which a goal can be reached, the way there, and the reach.

    Attributes:
        yaw: Heading of the object at rest; a carried one has turned with the body.
    """

    base: BasePose
    segment: Segment | None
    yaw: float
    grasp: Grasp
    posture: Posture


@dataclass(frozen=True)
class Held:
    """The way in which something in the hand was picked."""

    centre: Vector
    yaw: float
    heading: float
    grasp: Grasp


class Reachability:
    """One person in one room; all draws come from the plan's generator."""

    def __init__(self, preset: Preset, person: Person, room: Room, rng: np.random.Generator, is_seated: bool) -> None:
        self.preset = preset
        self.person = person
        self.room = room
        self.rng = rng
        self.is_seated = is_seated
        self.pelvis_height = people.seated_pelvis_height(person.body) if is_seated else None

    def hand_for(self, base: BasePose, centre: np.ndarray) -> int:
        """Draw the hand: with p = .75 the one on the side of the goal, else the preferred one."""
        preferred = int(self.person.habits.right_handed)
        if self.rng.random() >= 0.75:
            return preferred
        return int((centre - base.point) @ base.left < 0.0)

    def stand(
        self, base: BasePose, at_surface: int, goal: Goal, hand: int, held: Held | None, begin: float
    ) -> Stand | None:
        """Return a place from which a hand reaches a goal.

        Args:
            base: Place where the person stands.
            at_surface: Before which surface.
            goal: What to reach.
            hand: 0 left, 1 right.
            held: Set for a put: its grasp is repeated.
            begin: When the person starts to move, seconds.

        Returns:
            None if the goal is out of reach from everywhere tried.
        """
        # The one free number of a grasp: finger base to box surface, or wrist to box centre.
        span = (0.010, 0.017) if self.preset.grasp == "fingertips" else (0.078, 0.112)
        number = float(self.rng.uniform(*span))
        bent_low = None
        for place in self._places(base, at_surface, goal, hand):
            # Whoever works along one table keeps facing it.
            habits = self.person.habits
            segment = plan_segment(habits, self.preset.speed, base, place, begin, faces_on=self.preset.table_only)
            here = base if segment is None else segment.goal
            if not self.is_seated and np.hypot(goal.centre[0] - here.x, goal.centre[2] - here.z) < _NEAREST:
                break
            yaw, grasp, posture = self._hold(here, hand, goal, number, held)
            if posture.extension <= (_WITHIN_REACH if place is base else _STEP_NEARER_ABOVE):
                found = Stand(here, segment, yaw, grasp, posture)
                if posture.lean <= _DEEP_BEND or goal.centre[1] < _LOW_GOAL:
                    return found
                if bent_low is None or posture.lean < bent_low.posture.lean:
                    bent_low = found
        return bent_low

    def _hold(
        self, base: BasePose, hand: int, goal: Goal, number: float, held: Held | None
    ) -> tuple[float, Grasp, Posture]:
        """Find grasp and posture, which depend on one another through the shoulder: two rounds settle them."""
        who = Reacher(self.person, base, hand, self.pelvis_height)
        if held is not None:
            turned = base.heading - held.heading
            # The same grasp on an object that has moved and turned.
            wrist = goal.centre + turn(turned, 0.0, held.grasp.wrist - held.centre)
            grasp = Grasp(wrist, np.stack([turn(turned, 0.0, axis) for axis in held.grasp.hand.T], axis=-1))
            return held.yaw + turned, grasp, solve_posture(who, grasp.wrist)
        centre = goal.centre
        half = goal.half_extents
        if goal.handle is not None and goal.handle_half is not None:
            centre = goal.centre + turn(goal.yaw, 0.0, goal.handle)
            half = goal.handle_half

        def grasp_in(posture: Posture) -> Grasp:
            shoulder = shoulder_in_posture(who, posture)
            return take_hold(self.preset, self.person.body, shoulder, centre, half, goal.yaw, number)

        upright = Posture(0.0, 0.0, 0.0, 0.0)
        grasp = grasp_in(solve_posture(who, grasp_in(upright).wrist))
        return goal.yaw, grasp, solve_posture(who, grasp.wrist)

    def _places(self, base: BasePose, at_surface: int, goal: Goal, hand: int) -> list[BasePose]:
        """Return the standing places to try in turn: where one stands, the good place, then nearer ones."""
        if self.is_seated:
            return [base]
        front = self.room.surfaces[goal.surface]
        if self.preset.table_only:
            return self._table_places(base, front, goal.centre, hand)
        places = [base] if goal.surface == at_surface and self._feet_may_stay(base, goal.centre) else []
        good = self._standing_place(front, goal.centre, hand)
        towards = (goal.centre - good.point) * (1.0, 0.0, 1.0)
        for number in range(5):
            step = towards / np.linalg.norm(towards) * (_STEP * number)
            places.append(replace(good, x=good.x + float(step[0]), z=good.z + float(step[2])))
        return places

    def _feet_may_stay(self, base: BasePose, centre: np.ndarray) -> bool:
        offset = centre - base.point
        offset[1] = 0.0
        lateral = abs(float(offset @ base.left))
        ahead = float(offset @ base.forward)
        farthest = 0.31 * self.person.body.stature + 0.30
        return lateral <= 0.38 and ahead > 0.2 and float(np.linalg.norm(offset)) <= farthest

    def _standing_place(self, front: Surface, centre: np.ndarray, hand: int) -> BasePose:
        aside = float(self.rng.normal(0.12, 0.06)) * (1.0 if hand == 1 else -1.0)
        lateral = float((centre - front.edge_centre) @ front.left) + aside
        point = front.point(lateral, -float(self.rng.uniform(*self.preset.edge)))
        half_x, half_z = (side / 2.0 - _WALL_CLEARANCE for side in self.room.floor)
        point[0], point[2] = np.clip(point[0], -half_x, half_x), np.clip(point[2], -half_z, half_z)
        heading = front.facing + float(np.deg2rad(self.rng.uniform(-8.0, 8.0)))
        return BasePose(float(point[0]), float(point[2]), heading)

    def _table_places(self, base: BasePose, front: Surface, centre: np.ndarray, hand: int) -> list[BasePose]:
        """Return the places along one table: people shift most of the way to the good place, and lean for the rest."""
        good = self._standing_place(front, centre, hand)
        back = float(self.rng.uniform(-0.03, 0.08)) * front.normal
        place = BasePose(
            base.x + 0.75 * (good.x - base.x) + float(back[0]),
            base.z + 0.75 * (good.z - base.z) + float(back[2]),
            front.facing + float(np.deg2rad(4.0)) * float(self.rng.standard_normal()),
        )
        distances = [np.hypot(centre[0] - at.x, centre[2] - at.z) for at in (base, place)]
        return [place] if max(distances) <= 0.40 * self.person.body.stature else []
