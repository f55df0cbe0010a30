"""Grasps: the hand on a box, and the trunk that leans and crouches for it.

Source: docs/specification/synthetic-recordings.md#reaching-and-holding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.synthetic.people.base import BasePose
from prbench.synthetic.people.kinematics import UP, frame_of_bone, orthogonal_unit, turn, unit, wrap
from prbench.synthetic.people.person import Body, Person, pose_trunk, standing_pelvis_height
from prbench.synthetic.people.presets import Preset

_LEANS = np.deg2rad(np.linspace(0.0, 70.0, 15))
_CROUCHES = np.linspace(0.0, 0.5, 14)
_HAND_SLOPE = np.deg2rad(40.0)
_SHOULDER_FORWARD = np.deg2rad(9.0)


@dataclass(frozen=True)
class Grasp:
    """Place of the wrist and turn of the hand at the moment of the event."""

    wrist: Float[np.ndarray, "3"]
    hand: Float[np.ndarray, "3 3"]
    """World from hand; y from wrist to finger base."""

    def moved(self, before: np.ndarray, after: np.ndarray, turned: float) -> Grasp:
        """Return the same grasp on an object that moved from ``before`` to ``after`` and turned by ``turned``."""
        return Grasp(
            after + turn(turned, 0.0, self.wrist - before),
            np.stack([turn(turned, 0.0, axis) for axis in self.hand.T], axis=-1),
        )


@dataclass(frozen=True)
class Posture:
    """Lean and crouch of the trunk for a reach."""

    lean: float
    crouch: float
    """Share of the leg."""
    chest_turn: float
    """Chest against the heading, radians."""
    extension: float
    """Shoulder to wrist over arm length; above about .92 the goal is out of reach."""


def draw_grasp_number(preset: Preset, rng: np.random.Generator) -> float:
    """Return the one free number of a grasp: finger base to box surface, or wrist to box centre."""
    return float(rng.uniform(0.010, 0.017) if preset.grasp == "fingertips" else rng.uniform(0.078, 0.112))


def take_hold(
    preset: Preset,
    body: Body,
    shoulder: Float[np.ndarray, "3"],
    centre: Float[np.ndarray, "3"],
    half_extents: Float[np.ndarray, "3"],
    yaw: float,
    number: float,
) -> Grasp:
    """Return the grasp of a box by the hand of a given shoulder."""
    towards = unit(shoulder - centre)
    towards[1] = max(towards[1], 0.02) * 0.8
    towards = unit(towards)
    above = orthogonal_unit(UP, towards)
    backwards = towards * np.cos(_HAND_SLOPE) + above * np.sin(_HAND_SLOPE)
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
    grasp: Grasp,
    hand_length: float,
    centre: Float[np.ndarray, "3"],
    half_extents: Float[np.ndarray, "3"],
    yaw: float,
    clearance: float,
) -> Grasp:
    """Draw the hand back along itself until its finger base is ``clearance`` metres from the box."""
    backwards = -grasp.hand[:, 1]
    wrists = grasp.wrist + np.linspace(0.0, 0.25, 251)[:, None] * backwards
    in_box = turn(-yaw, 0.0, wrists - hand_length * backwards - centre)
    distance = np.linalg.norm(np.maximum(np.abs(in_box) - half_extents, 0.0), axis=-1)
    return Grasp(wrists[int(np.abs(distance - clearance).argmin())], grasp.hand)


def shoulder_in_posture(
    person: Person,
    base: BasePose,
    hand: int,
    posture: Posture,
    pelvis_height: float | None = None,
    offset: np.ndarray | None = None,
) -> Float[np.ndarray, "3"]:
    """Return where the reaching shoulder is in a posture at a standing place."""
    heights = _shoulders(
        person, base, hand, np.array([posture.lean]), np.array([posture.crouch]), posture.chest_turn, pelvis_height
    )
    return heights[0] + (0.0 if offset is None else offset)


def solve_posture(
    person: Person,
    base: BasePose,
    hand: int,
    wrist: Float[np.ndarray, "3"],
    pelvis_height: float | None = None,
    offset: np.ndarray | None = None,
) -> Posture:
    """Choose lean and crouch for a wrist target on a grid of 15 x 14 postures.

    Args:
        person: Who.
        base: Standing place.
        hand: 0 left, 1 right.
        wrist: Target, world frame.
        pelvis_height: Given for a seated person, who leans only.
        offset: True minus planned shoulder position, from an earlier pass.
    """
    bearing = wrap(np.arctan2(wrist[0] - base.x, wrist[2] - base.z) - base.heading)
    chest = 0.5 * float(np.clip(bearing, -1.4, 1.4)) + (_SHOULDER_FORWARD if hand == 1 else -_SHOULDER_FORWARD)
    crouches = _CROUCHES if pelvis_height is None else _CROUCHES[:1]
    lean, crouch = (grid.ravel() for grid in np.meshgrid(_LEANS, crouches, indexing="ij"))
    shoulders = _shoulders(person, base, hand, lean, crouch, chest, pelvis_height)
    if offset is not None:
        shoulders = shoulders + offset
    extension = np.linalg.norm(wrist - shoulders, axis=-1) / person.body.arm
    cost = (
        (crouch / 0.22) ** 2
        + (lean / 0.55) ** 2
        + 40.0 * np.maximum(0.0, extension - 0.88)
        + 4.0 * np.maximum(0.0, 0.5 - extension) ** 2
    )
    best = int(cost.argmin())
    return Posture(float(lean[best]), float(crouch[best]), chest, float(extension[best]))


def pelvis_setback(body: Body, lean: np.ndarray, crouch: np.ndarray) -> np.ndarray:
    """Return how far the pelvis moves back when the trunk leans or the knees bend, metres."""
    return 0.05 * body.stature * np.sin(lean) + 0.06 * crouch


def _shoulders(
    person: Person,
    base: BasePose,
    hand: int,
    lean: np.ndarray,
    crouch: np.ndarray,
    chest_turn: float,
    pelvis_height: float | None,
) -> np.ndarray:
    body = person.body
    if pelvis_height is None:
        height = standing_pelvis_height(body) - crouch * body.leg - 0.02 * lean
    else:
        height = np.full(lean.shape, pelvis_height)
    pelvis = base.point - pelvis_setback(body, lean, crouch)[:, None] * base.forward
    pelvis[:, 1] = height
    pelvis_turn = 0.3 * chest_turn
    trunk = pose_trunk(body, person.habits.stoop, pelvis, base.heading + pelvis_turn, base.heading + chest_turn, lean)
    return trunk.shoulders[hand]
