"""Where the hands of a script are at every frame, and where the elbows point."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.synthetic.activities.script import Hand, Loop, Script
from prbench.synthetic.people.arms import elbow_poles, move_wrists
from prbench.synthetic.people.channels import add_bump, blend, minimum_jerk
from prbench.synthetic.people.geometry import turn
from prbench.synthetic.people.head_eye import Head
from prbench.synthetic.people.legs import Legs
from prbench.synthetic.people.plan import Plan
from prbench.synthetic.people.posture import Sway
from prbench.synthetic.people.trunk import Trunk

_ALONG_THIGH, _ABOVE_THIGH = 0.62, 0.055
_LOOP_EASE = 0.35  # s in which a loop begins and ends


def move_hands(
    plan: Plan, script: Script, trunk: Trunk, legs: Legs, sway: Sway, head: Head, times: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 2 3"], Float[np.ndarray, "n 2 3"]]:
    """Wanted wrists, and directions of the elbows in the chest's frame. Commands are applied in time order."""
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
    hand, side = command.hand, (1.0 if command.hand == 0 else -1.0)
    stature = plan.person.body.stature
    offset = np.array([side * command.offset[0], command.offset[1], command.offset[2]]) * stature
    if command.place == "rest":
        return rest[:, hand]
    if command.place == "world":
        return np.array(command.offset)
    if command.place == "thigh":
        hip, knee = trunk.hips[hand], legs.knee[:, hand]
        return hip + _ALONG_THIGH * (knee - hip) + np.array([0.0, _ABOVE_THIGH, 0.0])
    if command.place == "head":
        middle = trunk.neck + turn(head.yaw, 0.0, np.array([0.0, 0.06 * stature, 0.02 * stature]))
        return middle + turn(head.yaw, 0.0, offset) + _loop(command.loop, trunk, times)
    shoulder = trunk.shoulders[hand]
    if command.place == "middle":
        shoulder = 0.5 * (trunk.shoulders[0] + trunk.shoulders[1])
    return shoulder + turn(trunk.yaws[3], 0.0, offset) + _loop(command.loop, trunk, times)


def _loop(loop: Loop | None, trunk: Trunk, times: np.ndarray) -> np.ndarray:
    """The ellipse in the chest's frame, growing at its beginning and shrinking at its end."""
    if loop is None:
        return np.zeros(3)
    size = minimum_jerk((times - loop.begin) / _LOOP_EASE) * minimum_jerk((loop.end - times) / _LOOP_EASE)
    phase = 2.0 * np.pi * loop.frequency * (times - loop.begin)
    way = np.sin(phase)[:, None] * loop.first + np.cos(phase)[:, None] * loop.second
    return turn(trunk.yaws[3], 0.0, size[:, None] * way)
