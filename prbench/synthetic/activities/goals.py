"""Words for picks and puts of prime-and-reach people: what, from where, on which side, how."""

from __future__ import annotations

import re

import numpy as np

from prbench.skeleton import Joint, facing_yaw
from prbench.synthetic.activities.narrate import TrueNarration
from prbench.synthetic.activities.wording import Facts, clause, sentence
from prbench.synthetic.people.plan import OPENING
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent

_LENGTH = (3.0, 5.0)
_FIRST_TEXT = 0.215  # s after the suit, as in real sequences of known clocks
_AFTER = 0.4  # s after the event that a narration still covers
_LOW, _HIGH = 0.6, 1.2  # metres; of surfaces
_WALKED = 0.8  # metres
_SLOW_REACH = 1.05  # s
_BESIDE = np.deg2rad(18.0)


def narrate_events(performance: Performance, rng: np.random.Generator) -> tuple[TrueNarration, ...]:
    """One narration for every pick and put of a performance, in time order; overlapping ones are left out."""
    narrations = _waiting(performance, rng)
    for event in sorted(performance.events, key=lambda event: event.event_time):
        if event.expected in ("not_an_event", "excluded_category", "other_wearer"):
            continue
        end = min(event.event_time + _AFTER, performance.duration)
        start = end - float(rng.uniform(*_LENGTH))
        last = narrations[-1].end if narrations else _FIRST_TEXT
        start = max(start, last)
        if end - start < 1.5:
            continue
        text = sentence([clause(goal_facts(performance, event, start), rng)], rng)
        narrations.append(TrueNarration("atomic_action", start, end, (text,), (event.action,)))
    return tuple(narrations)


def _waiting(performance: Performance, rng: np.random.Generator) -> list[TrueNarration]:
    """Everybody stands for some seconds before anything happens; seated people have no words here."""
    end = min([OPENING, *(event.motor_start for event in performance.events)])
    knees = performance.joints[0, [Joint.LEFT_KNEE, Joint.RIGHT_KNEE], 1].mean()
    if performance.joints[0, Joint.PELVIS, 1] < 1.4 * knees:
        return []
    text = sentence([clause(Facts("stand", {}), rng)], rng)
    return [TrueNarration("atomic_action", _FIRST_TEXT, end, (text,), ("stand",))]


def goal_facts(performance: Performance, event: TrueEvent, since: float) -> Facts:
    """What the words for a pick or put depend on.

    Args:
        performance: Who did it.
        event: What was done.
        since: From when on manners count, seconds.
    """
    first, last = np.searchsorted(performance.times, [since, event.event_time])
    joints = performance.joints[first : max(int(last), int(first) + 2)]
    slots = {
        "thing": f"the {spoken_name(event.object_name)}",
        "place": _place(performance, event),
        "hand": f"the {event.hand} hand",
        "side": _side(joints, event),
        "manner": _manner(joints, event),
    }
    return Facts(event.action, slots)


def spoken_name(name: str) -> str:
    """``cup_red`` and ``BlackCeramicMug`` as people say them: red cup, black ceramic mug."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name.replace("_", " "))
    words = [word.lower() for word in words]
    colours = {"red", "green", "blue", "pink", "white", "black", "bamboo"}
    if len(words) == 2 and words[1] in colours:
        words.reverse()
    return " ".join(words)


def _place(performance: Performance, event: TrueEvent) -> str:
    """The furniture under the goal, and whether it is low or high."""
    bottom = event.goal.copy()
    bottom[1] = event.box_min[1]
    surfaces = [item for item in performance.objects if not item.movable and len(item.position) == 1]
    nearest = min(surfaces, key=lambda item: _distance_to_top(item, bottom), default=None)
    name = "surface" if nearest is None else nearest.category.removeprefix("low ").removeprefix("high ")
    height = "low " if bottom[1] < _LOW else "high " if bottom[1] > _HIGH else ""
    return f"the {height}{name}"


def _distance_to_top(item: ObjectMotion, point: np.ndarray) -> float:
    """Of a point from the rectangle on top of a box that stands along the walls."""
    w, _, y, _ = item.rotation[0]
    yaw = 2.0 * np.arctan2(y, w)
    offset = point - item.position[0]
    along = offset[0] * np.cos(yaw) - offset[2] * np.sin(yaw)
    across = offset[0] * np.sin(yaw) + offset[2] * np.cos(yaw)
    beyond = np.maximum(np.abs([along, across]) - item.half_extents[[0, 2]], 0.0)
    return float(np.hypot(*beyond) + abs(offset[1] - item.half_extents[1]))


def _side(joints: np.ndarray, event: TrueEvent) -> str:
    """Where the goal is seen from the body at the event."""
    pelvis = joints[-1, Joint.PELVIS]
    bearing = np.arctan2(event.goal[0] - pelvis[0], event.goal[2] - pelvis[2]) - facing_yaw(joints[-1])
    bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
    return f"{'left' if bearing > 0 else 'right'}" if abs(bearing) > _BESIDE else f"{event.hand} hand side"


def _manner(joints: np.ndarray, event: TrueEvent) -> str:
    walked = float(np.linalg.norm((joints[-1] - joints[0])[Joint.PELVIS, [0, 2]]))
    if walked > _WALKED:
        return "after walking over"
    reach = event.contact_time - event.reach_start
    return "slowly" if reach > _SLOW_REACH else ""
