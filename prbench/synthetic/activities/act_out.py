"""From a script to joints: base, feet, trunk, head, arms, legs, by the channels of prime-and-reach motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from prbench.synthetic.activities.hands import move_hands
from prbench.synthetic.activities.script import Arc, Script
from prbench.synthetic.people.arms import pose_arms
from prbench.synthetic.people.base import BasePath, BasePose, sample_base
from prbench.synthetic.people.channels import blend, bump, eased_trapezoid
from prbench.synthetic.people.gaze_plan import GazePlan, Look
from prbench.synthetic.people.geometry import direction
from prbench.synthetic.people.head_eye import move_head
from prbench.synthetic.people.legs import pose_legs
from prbench.synthetic.people.motion import Motion, assemble
from prbench.synthetic.people.plan import Plan
from prbench.synthetic.people.posture import Bending, draw_sway, move_trunk
from prbench.synthetic.people.presets import Preset
from prbench.synthetic.people.steps import place_feet, plan_steps
from prbench.synthetic.people.trunk import seated_pelvis_height, standing_pelvis_height
from prbench.synthetic.people.world import Room

_SEAT_BACK = 0.22  # of the stature, behind the feet
_SITTING_LEAN = np.deg2rad(35.0)
_ARC_START, _ARC_STOP = 0.5, 0.65  # s
_NOWHERE = Room("", (0.0, 0.0), (), ())


def act_out(preset: Preset, script: Script, rate: float, rng: np.random.Generator) -> Motion:
    """The whole body at every frame.

    Args:
        preset: Gains of the head.
        script: What to do.
        rate: Frames a second.
        rng: For small movements and idle looks.
    """
    person = script.person
    times = np.arange(round(script.end * rate) + 1) / rate
    plan = Plan(preset, person, _NOWHERE, False, script.start, (), script.segments, ())
    feet_base = sample_moves(script, times)
    seated = _seated(script, times)
    base = _sat_back(feet_base, seated, person.body.stature)
    steps = plan_steps(person, script.segments)
    feet = place_feet(person, feet_base, steps, times, seated=False)
    sway = draw_sway(plan, feet_base, steps, times, rng)
    bending = _bending(script, seated, times)
    looks = _all_looks(script, feet_base, seated, times, rng)
    gaze = GazePlan(looks, (), ())
    rough = move_trunk(plan, base, bending, sway, feet, steps, times, None)
    eye = rough.neck + np.array([0.0, 0.06, 0.0]) * person.body.stature
    head = move_head(preset, person.habits, gaze, base.heading, eye, times, rng)
    trunk = move_trunk(plan, base, bending, sway, feet, steps, times, head)
    legs = pose_legs(person.body, np.stack(trunk.hips, axis=1), trunk.yaws[0], feet)
    wrists, poles = move_hands(plan, script, trunk, legs, sway, head, times)
    arms = pose_arms(person.body, person.habits.elbow_flare, trunk, wrists, poles)
    return assemble(plan, base, feet, trunk, head, arms, times, gaze, ())


def sample_moves(script: Script, times: Float[np.ndarray, " n"]) -> BasePath:
    """Where the feet carry the person, at every frame."""
    path = sample_base(script.start, (), times)
    x, z, heading = path.x.copy(), path.z.copy(), path.heading.copy()
    for move in script.moves:
        first = int(np.searchsorted(times, move.begin))
        if isinstance(move, Arc):
            duration = move.end - move.begin
            progress = eased_trapezoid(
                (times[first:] - move.begin) / duration,
                min(_ARC_START / duration, 0.45),
                min(_ARC_STOP / duration, 0.5),
            )
            x[first:], z[first:], heading[first:] = move.at(progress)
        else:
            part = sample_base(move.start, (move,), times)
            x[first:], z[first:], heading[first:] = part.x[first:], part.z[first:], part.heading[first:]
    velocity = np.gradient(np.stack([x, z], axis=-1), times, axis=0)
    return BasePath(x, z, heading, np.hypot(velocity[:, 0], velocity[:, 1]))


def _seated(script: Script, times: np.ndarray) -> Float[np.ndarray, " n"]:
    """0 standing to 1 sitting."""
    seated = np.zeros(times.size)
    for sit in script.sits:
        blend(seated, times, sit.begin, sit.duration, float(sit.down))
    return seated


def _sat_back(base: BasePath, seated: np.ndarray, stature: float) -> BasePath:
    """The pelvis moves back onto the seat; the feet stay."""
    back = _SEAT_BACK * stature * seated
    return replace(base, x=base.x - back * np.sin(base.heading), z=base.z - back * np.cos(base.heading))


def _bending(script: Script, seated: np.ndarray, times: np.ndarray) -> Bending:
    """Lean and crouch of the bends, and what sitting adds."""
    channels = np.zeros((times.size, 3))
    for bend in sorted(script.bends, key=lambda bend: bend.begin):
        blend(channels, times, bend.begin, bend.duration, np.array([bend.lean, bend.crouch, bend.chest_turn]))
    lean, crouch = channels[:, 0], channels[:, 1]
    for sit in script.sits:
        lean += _SITTING_LEAN * bump((times - sit.begin) / sit.duration)
    body = script.person.body
    drop = (standing_pelvis_height(body) - seated_pelvis_height(body)) / body.leg
    return Bending(lean, crouch + drop * seated, channels[:, 2])


def _all_looks(
    script: Script, base: BasePath, seated: np.ndarray, times: np.ndarray, rng: np.random.Generator
) -> tuple[Look, ...]:
    """The looks of the activities, and looks ahead in between."""
    looks: list[Look] = []
    now = 0.0
    last = Look(float(times[-1]), float(times[-1]), np.zeros(3), False, None)
    for planned in (*sorted(script.looks, key=lambda look: look.start), last):
        while planned.start - now > 1e-9:
            length = min(float(np.clip(0.7 * np.exp(0.4 * rng.standard_normal()), 0.3, 1.6)), planned.start - now)
            looks.append(Look(now, now + length, _ahead(script, base, seated, times, now, rng), False, None))
            now += length
        if planned is not last:
            looks.append(planned)
            now = planned.end
    return tuple(looks)


def _ahead(
    script: Script, base: BasePath, seated: np.ndarray, times: np.ndarray, now: float, rng: np.random.Generator
) -> np.ndarray:
    """A point some metres ahead of where the person will soon be and face."""
    index = min(int(np.searchsorted(times, now + 0.5)), times.size - 1)
    pose: BasePose = base.pose(index)
    height = script.person.body.stature * (0.93 - 0.22 * float(seated[index]))
    yaw, pitch = pose.heading + rng.normal(0.0, 0.22), rng.normal(0.16, 0.08)
    return pose.point + np.array([0.0, height, 0.0]) + rng.uniform(2.0, 3.5) * direction(yaw, pitch)
