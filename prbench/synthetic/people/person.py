"""Who acts: the constants of each preset, and the body and habits of one person.

Source: docs/specification/synthetic-recordings.md#person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Literal

import msgspec
import numpy as np
from scipy.special import betainc

from prbench.protocol.manifests import read_toml
from prbench.synthetic.people.kinematics import Angle, eased_trapezoid, minimum_jerk, turn
from prbench.synthetic.performance import Body, Habits, Manner, Person, Progress


class SurfaceKind(msgspec.Struct, frozen=True, array_like=True):
    """A kind of furniture on which objects stand.

    Attributes:
        weight: Share of the goals that lie on surfaces of this kind.
    """

    name: str
    height: float
    depth: float
    weight: float


class ObjectKind(msgspec.Struct, frozen=True, array_like=True):
    """A kind of object; without extents a box is drawn."""

    name: str
    category: str
    half_extents: tuple[float, float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Every constant in which one dataset's world and people differ from the others'. Metres, seconds, degrees.

    Attributes:
        room: Free floor between the front edges of the furniture: x, z.
        same_surface: Probability that the next goal is on the surface one stands at.
        near: Probability that the next spot is drawn around the previous one.
        edge: Distance of the pelvis from the front edge when standing before it.
        gap: Planned prime gap: weight, median and log-sd of each log-normal part; empty: gaze follows the motor start.
        prime_look: Median length of the first look at a goal.
        spine_up: Upward parts of pelvis-spine1, spine1-spine2, spine2-spine3, fractions of stature.
        work_pose: Waiting hands relative to the shoulder (outwards, up, forward; fractions of stature); None: hanging.
        work_looks: Share of the fill fixations that go to the own hands or the work area.
        table_only: One table, people shift along it instead of walking.
    """

    name: str
    room: tuple[float, float]
    surfaces: tuple[SurfaceKind, ...]
    n_surfaces: int
    same_surface: float
    near: float
    spread: float
    edge: tuple[float, float]
    objects: tuple[ObjectKind, ...]
    gap: tuple[tuple[float, float, float], ...]
    idle: tuple[float, float]
    speed: float
    unprimed: float
    near_miss: float
    head_gain: float
    chest_gain: float
    prime_look: float
    spine_up: tuple[float, float, float]
    neck_offset: tuple[float, float, float]
    neck_length: float
    neck_tilt_deg: float
    grasp: Literal["fingertips", "wrapped", "wrist"]
    work_pose: tuple[float, float, float] | None = None
    carry_pose: tuple[float, float, float]
    work_looks: float
    spot_spacing: float
    puts: bool
    table_only: bool
    seated_share: float


# A row for each field of :class:`Preset`: its values by the presets' names.
_ROWS = read_toml("prbench.synthetic.people", "presets.toml", dict[str, dict[str, Any]])


def _preset(name: str) -> Preset:
    return msgspec.convert({field: row[name] for field, row in _ROWS.items() if name in row} | {"name": name}, Preset)


# The five presets by name.
PRESETS: Mapping[str, Preset] = MappingProxyType({name: _preset(name) for name in _ROWS["room"]})


def draw_person(preset: Preset, participant_id: str, rng: np.random.Generator) -> Person:
    """Draw one person for a preset."""
    stature = float(np.clip(rng.normal(1.70, 0.095), 1.50, 1.95))
    body = _draw_body(preset, stature, rng)

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    def degrees(low: float, high: float) -> float:
        return float(np.deg2rad(rng.uniform(low, high)))

    # The order of the draws is part of every synthetic person.
    goal_gain = between(0.82, 1.0)
    habits = Habits(
        walk_speed=float(np.clip(rng.normal(1.15, 0.12), 0.85, 1.45)),
        walk_ratio=float(rng.normal(0.0063, 0.0005)) * stature / 1.7,
        half_stance=between(0.07, 0.12),
        toe_out=degrees(3.0, 11.0),
        arm_swing=degrees(14.0, 28.0),
        stoop=degrees(0.0, 6.0),
        elbow_flare=between(0.25, 0.55),
        goal_gain=goal_gain,
        fill_gain=between(0.50, 0.75),
        goal_gain_vertical=between(0.80, 1.0),
        fill_gain_vertical=between(0.35, 0.60),
        eye_only_range=degrees(8.0, 18.0),
        head_lag=between(-0.060, 0.030),
        neck_share=between(0.85, 1.0),
        chest_share=between(0.45, 0.65),
        pelvis_share=between(0.10, 0.22),
        trunk_time=between(0.10, 0.18),
        reach_time=between(0.85, 1.15),
        turn_rate=degrees(52.0, 76.0),
        right_handed=float(rng.random() < 0.9),
        toe_clearance=between(0.014, 0.024),
    )
    return Person(participant_id, body, habits, _USUAL)


def _reach_of_grasping(x: np.ndarray) -> np.ndarray:
    """Hands that grasp are fastest before the middle of their way and slow from three quarters of it on.

    Source: Jeannerod 1984.
    """
    return minimum_jerk(x * (1.0 + 0.25 * (1.0 - x)))


def _swing_in_middle(x: np.ndarray) -> np.ndarray:
    return eased_trapezoid((x - 0.09) / 0.81, 0.34, 0.34)


_USUAL = Manner(
    reach=_reach_of_grasping,
    turn_head=minimum_jerk,
    head_turn=(0.23, 0.0112),
    swing_foot=_swing_in_middle,
    reach_time=(0.50, 0.80),
    hump=(0.06, 0.09),
    bends=(0.22, 0.55),
    even_steps=False,
)


def _beta(first: float, second: float) -> Progress:
    """Return the progress of a speed x^(first - 1) (1 - x)^(second - 1); 3 and 3 are minimum jerk."""
    return partial(betainc, first, second)


# The second world, only for tests of transfer (docs/specification/synthetic-recordings.md#a-second-world).
_SECOND = Manner(
    reach=_beta(4.0, 4.4),
    turn_head=_beta(3.0, 4.5),
    head_turn=(0.40, 0.0085),
    swing_foot=_beta(3.5, 3.0),
    reach_time=(0.70, 0.45),
    hump=(0.03, 0.05),
    bends=(0.24, 0.42),
    even_steps=True,
)


def of_second_world(person: Person, rng: np.random.Generator) -> Person:
    """Give a person other proportions, habits and laws of movement than those of people who are learnt from.

    Segments are those of Drillis and Contini (1966, in Winter 2009, figure 4.1) as fractions of stature.
    """
    stature = person.body.stature
    leg, arm = 1.0 + 0.03 * np.clip(rng.standard_normal(2), -2.0, 2.0)
    lengths = {"thigh": 0.245 * leg, "shin": 0.246 * leg, "upper_arm": 0.186 * arm, "forearm": 0.146 * arm}
    body = replace(person.body, **{name: float(share) * stature for name, share in lengths.items()})
    # The order of the draws is that of the rows.
    habits = {name: float(rng.uniform(*ends)) for name, ends in _ROWS["second_world"].items()}
    habits["turn_rate"] = float(np.deg2rad(habits["turn_rate"]))
    return replace(person, body=body, habits=replace(person.habits, **habits), manner=_SECOND)


def _draw_body(preset: Preset, stature: float, rng: np.random.Generator) -> Body:
    spreads = (0.03, 0.03, 0.05, 0.025)
    leg, arm, shoulders, trunk = (1.0 + sd * float(np.clip(rng.standard_normal(), -2.7, 2.7)) for sd in spreads)
    forward = (-0.010, 0.004, 0.002)
    spine = [(0.0, u * trunk * stature, f * trunk * stature) for u, f in zip(preset.spine_up, forward, strict=True)]
    spine.append(_scaled(preset.neck_offset, trunk * stature))
    hip = _scaled((0.036 * shoulders, -0.048, -0.006), stature)
    thigh_to_foot = (0.2252 * leg * stature, 0.2466 * leg * stature, 0.036 * stature, 0.076 * stature)
    neck = (preset.neck_length * stature, float(np.deg2rad(preset.neck_tilt_deg)))
    collar = _scaled((0.041 * shoulders, 0.060 * trunk, -0.010), stature)
    shoulder = _scaled((0.0695 * shoulders, 0.012, -0.008), stature)
    upper_arm_to_hand = (0.149 * arm * stature, 0.154 * arm * stature, 0.047 * stature)
    eye = _scaled((0.0, 0.012, 0.055), stature)
    return Body(stature, hip, *thigh_to_foot, tuple(spine), *neck, collar, shoulder, *upper_arm_to_hand, eye)


def _scaled(offset: tuple[float, float, float], scale: float) -> tuple[float, float, float]:
    return offset[0] * scale, offset[1] * scale, offset[2] * scale


_PELVIS_SHARE_OF_LEAN = 0.4
# Hip height above the ankle when standing, share of the leg: a knee of 164 degrees.
_STANDING_LEG = 0.990
# Ball of the resting foot above the floor, metres.
BALL_HEIGHT = 0.013


@dataclass(frozen=True)
class Trunk:
    """Positions in metres, world frame; yaw and pitch of the segments in radians.

    Attributes:
        yaws: Pelvis, spine1, spine2, spine3 (the chest).
    """

    pelvis: np.ndarray
    hips: tuple[np.ndarray, ...]
    spine: tuple[np.ndarray, ...]
    neck: np.ndarray
    collars: tuple[np.ndarray, ...]
    shoulders: tuple[np.ndarray, ...]
    yaws: tuple[np.ndarray, ...]
    pitches: tuple[np.ndarray, ...]


def pose_trunk(body: Body, stoop: float, pelvis: np.ndarray, pelvis_yaw: Angle, chest_yaw: Angle, lean: Angle) -> Trunk:
    """Place the trunk's joints.

    Args:
        body: Bone offsets.
        stoop: Constant extra lean of the spine, radians.
        pelvis: Positions (..., 3).
        pelvis_yaw: Heading of the pelvis.
        chest_yaw: Heading of the chest, not wrapped against the pelvis.
        lean: Forward lean of the chest without the stoop.
    """
    lean = np.asarray(lean, dtype=np.float64)
    twist = np.asarray(chest_yaw) - pelvis_yaw
    bend = (1.0 - _PELVIS_SHARE_OF_LEAN) * lean + stoop
    yaws = tuple(np.asarray(pelvis_yaw + twist * third / 3.0) for third in range(4))
    pitches = tuple(_PELVIS_SHARE_OF_LEAN * lean + bend * third / 3.0 for third in range(4))
    joints = [pelvis]
    for yaw, pitch, offset in zip(yaws, pitches, body.spine, strict=True):
        joints.append(joints[-1] + turn(yaw, pitch, np.array(offset)))
    _, *spine, neck = joints

    def both(segment: int, offset: tuple[float, float, float], *origins: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the left and the right joint of a pair, by the offset of the left one in its segment."""
        offsets = (np.array(offset), np.array([-offset[0], offset[1], offset[2]]))
        turned = [turn(yaws[segment], pitches[segment], one) for one in offsets]
        return tuple(origin + way for origin, way in zip(origins, turned, strict=True))

    collars = both(3, body.collar, spine[2], spine[2])
    shoulders = both(3, body.shoulder, *collars)
    return Trunk(pelvis, both(0, body.hip, pelvis, pelvis), tuple(spine), neck, collars, shoulders, yaws, pitches)


def standing_pelvis_height(body: Body) -> float:
    """Return the pelvis height of a person who stands upright."""
    return BALL_HEIGHT + body.ankle_height + _STANDING_LEG * body.leg - body.hip[1]


def seated_pelvis_height(body: Body) -> float:
    """Return the pelvis height of a person who sits."""
    return 0.34 * body.stature
