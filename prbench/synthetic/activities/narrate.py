"""Texts of an activity recording: atomic actions, the four answers about the body, and summaries."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import Joint, facing_yaw
from prbench.synthetic.activities.acts import PAUSE, SHORT
from prbench.synthetic.activities.patterns import BODY_POSTURE
from prbench.synthetic.activities.script import Act, Script
from prbench.synthetic.activities.wording import Facts, Span, clause, facts_of, sentence
from prbench.synthetic.people.legs import plan_steps
from prbench.synthetic.people.motion import Motion
from prbench.synthetic.people.plan import OPENING
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent


@dataclass(frozen=True)
class TrueNarration:
    """One span of text."""

    kind: Literal["atomic_action", "motion_narration", "activity_summarization"]
    start: float
    """Seconds from the recording's first frame."""
    end: float
    texts: tuple[str, ...]
    """One for each answer of the kind."""
    activities: tuple[str, ...]
    """What happens, by name; for checks, never written."""


@dataclass(frozen=True)
class NarratedMotion:
    """One recording of the corpus, noise-free. Metres, Y up, floor at y = 0; quaternions w x y z, segment to world."""

    recording_id: str
    participant_id: str
    split: Literal["train", "validation", "test"]
    rate: float
    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 4"]
    """See :class:`prbench.synthetic.performance.Performance`."""
    head_rotation: Float[np.ndarray, "n 4"]
    """True head: x left, y up, z forward."""
    eye: Float[np.ndarray, "n 3"]
    planted: Bool[np.ndarray, "n 2"]
    neck_tilt_deg: float
    narrations: tuple[TrueNarration, ...]

    @property
    def times(self) -> Float[np.ndarray, " n"]:
        """Seconds from the first frame."""
        return np.arange(len(self.joints)) / self.rate

    @property
    def duration(self) -> float:
        """Seconds from first to last frame."""
        return (len(self.joints) - 1) / self.rate


_SHORTEST = 3.0
_LONGEST = 5.0
_CUT_OFF = 1.0  # s of a second activity that a narration need not cover
_SUMMARY = 22.0  # s
_LEGS = {
    "walk straight": "steps forward one foot after the other",
    "walk turning": "steps round and then forward",
    "curve": "steps forward along a bend",
    "carry": "steps forward",
    "turn": "makes small turning steps",
    "sidestep": "steps sideways",
    "step back": "steps backwards",
    "sit": "keeps both feet on the floor with bent knees",
    "sit down": "bends both knees, feet on the floor",
    "stand up": "straightens both knees",
    "crouch": "bends both knees deeply",
}


def narrate(script: Script, motion: Motion, rate: float, rng: np.random.Generator) -> tuple[TrueNarration, ...]:
    """Describe every activity in words, from what the body did.

    Args:
        script: What was planned, for names and times.
        motion: What happened.
        rate: Frames a second.
        rng: Of the choice of words.
    """
    facts = [(act, facts_of(act.name, act.hand, _span(script, motion, act, rate))) for act in script.acts]
    atomic = _atomic(facts, rng)
    about_body = [_about_body(act, fact) for act, fact in facts if act.end - act.begin >= 2.0]
    return (*atomic, *about_body, *_summaries(facts))


def _span(script: Script, motion: Motion, act: Act, rate: float) -> Span:
    first = round(act.begin * rate)
    last = min(round(act.end * rate), len(motion.joints) - 1)
    joints = motion.joints[first : last + 1]
    heading = motion.base.heading[first : last + 1]
    steps = sum(act.begin <= step.lift < act.end for step in plan_steps(script.person, script.segments))
    return Span(joints, heading, motion.head.yaw[first : last + 1] - heading, rate, int(steps))


def _atomic(facts: list[tuple[Act, Facts]], rng: np.random.Generator) -> list[TrueNarration]:
    """Write one row an activity; two short neighbours may share one."""
    narrations = []
    number = 0
    while number < len(facts):
        act, fact = facts[number]
        told = [fact]
        end = act.end
        if act.name in SHORT and number + 1 < len(facts):
            following, next_fact = facts[number + 1]
            if following.begin - act.end < PAUSE[1] and following.end - act.begin <= _LONGEST + _CUT_OFF:
                told.append(next_fact)
                end = following.end
        number += len(told)
        latest = facts[number][0].begin if number < len(facts) else end
        end = max(end, min(act.begin + _SHORTEST, latest))
        names = tuple(each.name for each in told)
        text = sentence([clause(each, rng) for each in told], rng)
        narrations.append(TrueNarration("atomic_action", act.begin, min(end, act.begin + _LONGEST), (text,), names))
    return narrations


def _about_body(act: Act, fact: Facts) -> TrueNarration:
    hand = fact.slots.get("hand", "")
    arms = f"C moves {hand}." if hand else "C keeps both arms at rest."
    if fact.name in ("raise arms", "look at hands"):
        arms = "C lifts both arms."
    texts = (
        f"C {BODY_POSTURE.get(fact.name, 'stands upright')}.",
        arms,
        f"C {_LEGS.get(fact.name, 'keeps both feet in place')}.",
        "C looks from side to side." if fact.name == "look around" else "C looks ahead.",
    )
    return TrueNarration("motion_narration", act.begin, min(act.end, act.begin + _LONGEST), texts, (fact.name,))


def _summaries(facts: list[tuple[Act, Facts]]) -> list[TrueNarration]:
    """Return what happened in stretches of 15 to 30 seconds."""
    narrations: list[TrueNarration] = []
    members: list[tuple[Act, Facts]] = []
    for act, fact in facts:
        members.append((act, fact))
        if act.end - members[0][0].begin >= _SUMMARY:
            names = list(dict.fromkeys(_DOING[each.name] for _, each in members))
            text = f"C {', '.join(names[:-1])} and {names[-1]}." if len(names) > 1 else f"C {names[0]}."
            narrations.append(
                TrueNarration("activity_summarization", members[0][0].begin, act.end, (text,), tuple(names))
            )
            members = []
    return narrations


_DOING = {
    "walk straight": "walks", "walk turning": "walks about", "curve": "walks in curves", "turn": "turns",
    "stand": "waits", "sit": "sits", "look around": "looks around", "look at hands": "looks at the hands",
    "sidestep": "steps aside", "step back": "steps back", "reach": "reaches for things", "carry": "carries something",
    "wipe": "wipes a surface", "stir": "stirs", "crouch": "crouches", "bend": "bends down", "wave": "waves",
    "raise arms": "raises the arms", "scratch head": "scratches the head", "sit down": "sits down",
    "stand up": "stands up",
}  # fmt: skip


_LENGTH_OF_EVENT = (3.0, 5.0)
_FIRST_TEXT = 0.215  # s after the suit, as in real sequences of known clocks
_AFTER = 0.4  # s after the event that a narration still covers
_LOW = 0.6  # metres; of surfaces
_HIGH = 1.2
_WALKED = 0.8  # metres
_SLOW_REACH = 1.05  # s
_BESIDE = np.deg2rad(18.0)


def narrate_events(performance: Performance, rng: np.random.Generator) -> tuple[TrueNarration, ...]:
    """Write one narration for every pick and put of a performance, in time order, without overlaps."""
    narrations = _waiting(performance, rng)
    for event in sorted(performance.events, key=lambda event: event.event_time):
        if event.expected in ("not_an_event", "excluded_category", "other_wearer"):
            continue
        end = min(event.event_time + _AFTER, performance.duration)
        start = end - float(rng.uniform(*_LENGTH_OF_EVENT))
        last = narrations[-1].end if narrations else _FIRST_TEXT
        start = max(start, last)
        if end - start < 1.5:
            continue
        text = sentence([clause(_goal_facts(performance, event, start), rng)], rng)
        narrations.append(TrueNarration("atomic_action", start, end, (text,), (event.action,)))
    return tuple(narrations)


def _waiting(performance: Performance, rng: np.random.Generator) -> list[TrueNarration]:
    """Describe the seconds of standing before anything happens; seated people have no words here."""
    end = min([OPENING, *(event.motor_start for event in performance.events)])
    knees = performance.joints[0, [Joint.LEFT_KNEE, Joint.RIGHT_KNEE], 1].mean()
    if performance.joints[0, Joint.PELVIS, 1] < 1.4 * knees:
        return []
    text = sentence([clause(Facts("stand", {}), rng)], rng)
    return [TrueNarration("atomic_action", _FIRST_TEXT, end, (text,), ("stand",))]


def _goal_facts(performance: Performance, event: TrueEvent, since: float) -> Facts:
    """Return what the words for a pick or put depend on.

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
    """Return ``cup_red`` and ``BlackCeramicMug`` as people say them: red cup, black ceramic mug."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name.replace("_", " "))
    words = [word.lower() for word in words]
    colours = {"red", "green", "blue", "pink", "white", "black", "bamboo"}
    if len(words) == 2 and words[1] in colours:
        words.reverse()
    return " ".join(words)


def _place(performance: Performance, event: TrueEvent) -> str:
    """Return the furniture under the goal, and whether it is low or high."""
    bottom = event.goal.copy()
    bottom[1] = event.box_min[1]
    surfaces = [item for item in performance.objects if not item.movable and len(item.position) == 1]
    nearest = min(surfaces, key=lambda item: _distance_to_top(item, bottom), default=None)
    name = "surface" if nearest is None else nearest.category.removeprefix("low ").removeprefix("high ")
    height = ""
    if bottom[1] < _LOW:
        height = "low "
    elif bottom[1] > _HIGH:
        height = "high "
    return f"the {height}{name}"


def _distance_to_top(item: ObjectMotion, point: np.ndarray) -> float:
    """Return the distance of a point from the rectangle on top of a box that stands along the walls."""
    w, _, y, _ = item.rotation[0]
    yaw = 2.0 * np.arctan2(y, w)
    offset = point - item.position[0]
    along = offset[0] * np.cos(yaw) - offset[2] * np.sin(yaw)
    across = offset[0] * np.sin(yaw) + offset[2] * np.cos(yaw)
    beyond = np.maximum(np.abs([along, across]) - item.half_extents[[0, 2]], 0.0)
    return float(np.hypot(*beyond) + abs(offset[1] - item.half_extents[1]))


def _side(joints: np.ndarray, event: TrueEvent) -> str:
    """Return in words where the goal lies, seen from the body at the event."""
    pelvis = joints[-1, Joint.PELVIS]
    bearing = np.arctan2(event.goal[0] - pelvis[0], event.goal[2] - pelvis[2]) - facing_yaw(joints[-1])
    bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
    if abs(bearing) <= _BESIDE:
        return f"{event.hand} hand side"
    return "left" if bearing > 0 else "right"


def _manner(joints: np.ndarray, event: TrueEvent) -> str:
    walked = float(np.linalg.norm((joints[-1] - joints[0])[Joint.PELVIS, [0, 2]]))
    if walked > _WALKED:
        return "after walking over"
    reach = event.contact_time - event.reach_start
    return "slowly" if reach > _SLOW_REACH else ""
