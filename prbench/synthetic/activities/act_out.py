"""Turns a script into joints: base, feet, trunk, head, arms, legs, by the channels of prime-and-reach motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from prbench.synthetic.activities.script import Arc, Hand, Loop, Script
from prbench.synthetic.people.arms import elbow_poles, move_wrists, pose_arms
from prbench.synthetic.people.base import BasePath, BasePose, sample_base
from prbench.synthetic.people.gaze_plan import GazePlan, Look
from prbench.synthetic.people.head_eye import Head, move_head
from prbench.synthetic.people.kinematics import add_bump, blend, bump, direction, eased_trapezoid, minimum_jerk, turn
from prbench.synthetic.people.legs import Legs, place_feet, plan_steps, pose_legs
from prbench.synthetic.people.motion import Motion, assemble
from prbench.synthetic.people.person import Trunk, seated_pelvis_height, standing_pelvis_height
from prbench.synthetic.people.plan import Plan
from prbench.synthetic.people.posture import Bending, Sway, draw_sway, move_trunk
from prbench.synthetic.people.presets import Preset
from prbench.synthetic.people.world import Room

_ALONG_THIGH = 0.62
_ABOVE_THIGH = 0.055
_LOOP_EASE = 0.35  # s in which a loop begins and ends
_SEAT_BACK = 0.22  # of the stature, behind the feet
_SITTING_LEAN = np.deg2rad(35.0)
_ARC_START = 0.5  # s
_ARC_STOP = 0.65
_NOWHERE = Room("", (0.0, 0.0), (), ())


def act_out(preset: Preset, script: Script, rate: float, rng: np.random.Generator) -> Motion:
    """Return the whole body at every frame.

    Args:
        preset: Gains of the head.
        script: What to do.
        rate: Frames a second.
        rng: For small movements and idle looks.
    """
    person = script.person
    times = np.arange(round(script.end * rate) + 1) / rate
    plan = Plan(preset, person, _NOWHERE, False, script.start, (), script.segments, ())
    feet_base = _sample_moves(script, times)
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
    wrists, poles = _move_hands(plan, script, trunk, legs, sway, head, times)
    arms = pose_arms(person.body, person.habits.elbow_flare, trunk, wrists, poles)
    return assemble(plan, base, feet, trunk, head, arms, times, gaze, ())


def _sample_moves(script: Script, times: Float[np.ndarray, " n"]) -> BasePath:
    """Return where the feet carry the person, at every frame."""
    path = sample_base(script.start, (), times)
    x = path.x.copy()
    z = path.z.copy()
    heading = path.heading.copy()
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
    """Return 0 where the person stands to 1 where they sit."""
    seated = np.zeros(times.size)
    for sit in script.sits:
        blend(seated, times, sit.begin, sit.duration, float(sit.down))
    return seated


def _sat_back(base: BasePath, seated: np.ndarray, stature: float) -> BasePath:
    """Move the pelvis back onto the seat; the feet stay."""
    back = _SEAT_BACK * stature * seated
    return replace(base, x=base.x - back * np.sin(base.heading), z=base.z - back * np.cos(base.heading))


def _bending(script: Script, seated: np.ndarray, times: np.ndarray) -> Bending:
    """Lean and crouch of the bends, and what sitting adds."""
    channels = np.zeros((times.size, 3))
    for bend in sorted(script.bends, key=lambda bend: bend.begin):
        blend(channels, times, bend.begin, bend.duration, np.array([bend.lean, bend.crouch, bend.chest_turn]))
    lean = channels[:, 0]
    crouch = channels[:, 1]
    for sit in script.sits:
        lean += _SITTING_LEAN * bump((times - sit.begin) / sit.duration)
    body = script.person.body
    drop = (standing_pelvis_height(body) - seated_pelvis_height(body)) / body.leg
    return Bending(lean, crouch + drop * seated, channels[:, 2])


def _all_looks(
    script: Script, base: BasePath, seated: np.ndarray, times: np.ndarray, rng: np.random.Generator
) -> tuple[Look, ...]:
    """Return the looks of the activities, and looks ahead in between."""
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
    """Return a point some metres ahead of where the person will soon be and face."""
    index = min(int(np.searchsorted(times, now + 0.5)), times.size - 1)
    pose: BasePose = base.pose(index)
    height = script.person.body.stature * (0.93 - 0.22 * float(seated[index]))
    yaw = pose.heading + rng.normal(0.0, 0.22)
    pitch = rng.normal(0.16, 0.08)
    return pose.point + np.array([0.0, height, 0.0]) + rng.uniform(2.0, 3.5) * direction(yaw, pitch)


def _move_hands(
    plan: Plan, script: Script, trunk: Trunk, legs: Legs, sway: Sway, head: Head, times: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 2 3"]]:
    """Return wanted wrists, and directions of the elbows in the chest's frame. Commands act in time order."""
    rest = move_wrists(plan, trunk, sway, times)
    wrists = rest.copy()
    commands = sorted(script.hands, key=lambda command: command.begin)
    for command in commands:
        target = _target(plan, command, trunk, legs, rest, head, times)
        blend(wrists[:, command.hand], times, command.begin, command.duration, target)
        if command.bulge:
            forward = turn(trunk.yaws[3], 0.0, np.array([0.0, 0.0, command.bulge]))
            first, last = np.searchsorted(times, [command.begin, command.begin + command.duration])
            add_bump(wrists[:, command.hand], times, command.begin, command.duration, forward[first:last])
    usual = elbow_poles(plan.person.habits.elbow_flare, trunk, wrists)
    poles = usual.copy()
    for command in commands:
        pole = usual[:, command.hand]
        if command.pole is not None:
            outwards, up, forward = command.pole
            pole = np.array([outwards if command.hand == 0 else -outwards, up, forward])
        blend(poles[:, command.hand], times, command.begin, command.duration, pole)
    return wrists, poles


def _target(
    plan: Plan, command: Hand, trunk: Trunk, legs: Legs, rest: np.ndarray, head: Head, times: np.ndarray
) -> np.ndarray:
    hand = command.hand
    side = 1.0 if command.hand == 0 else -1.0
    stature = plan.person.body.stature
    offset = np.array([side * command.offset[0], command.offset[1], command.offset[2]]) * stature
    if command.place == "rest":
        return rest[:, hand]
    if command.place == "world":
        return np.array(command.offset)
    if command.place == "thigh":
        hip = trunk.hips[hand]
        knee = legs.knee[:, hand]
        return hip + _ALONG_THIGH * (knee - hip) + np.array([0.0, _ABOVE_THIGH, 0.0])
    if command.place == "head":
        middle = trunk.neck + turn(head.yaw, 0.0, np.array([0.0, 0.06 * stature, 0.02 * stature]))
        return middle + turn(head.yaw, 0.0, offset) + _loop(command.loop, trunk, times)
    shoulder = trunk.shoulders[hand]
    if command.place == "middle":
        shoulder = 0.5 * (trunk.shoulders[0] + trunk.shoulders[1])
    return shoulder + turn(trunk.yaws[3], 0.0, offset) + _loop(command.loop, trunk, times)


def _loop(loop: Loop | None, trunk: Trunk, times: np.ndarray) -> np.ndarray:
    """Return the ellipse in the chest's frame, growing at its beginning and shrinking at its end."""
    if loop is None:
        return np.zeros(3)
    size = minimum_jerk((times - loop.begin) / _LOOP_EASE) * minimum_jerk((loop.end - times) / _LOOP_EASE)
    phase = 2.0 * np.pi * loop.frequency * (times - loop.begin)
    way = np.sin(phase)[:, None] * loop.first + np.cos(phase)[:, None] * loop.second
    return turn(trunk.yaws[3], 0.0, size[:, None] * way)
