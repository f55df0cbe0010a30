"""Sentence patterns that describe an activity: at least eight patterns an activity, twelve for picking and putting.

Clauses begin with the verb; the subject comes before them. Slots in braces are filled from what truly happened
(:mod:`prbench.synthetic.activities.narrate`); a slot may be empty.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import msgspec
import numpy as np
from jaxtyping import Bool, Float

from prbench.geometry.skeleton import WRISTS, Joint, facing_yaw
from prbench.protocol.manifests import read_toml
from prbench.synthetic.activities.script import PAUSE, SHORT, Act, Script
from prbench.synthetic.people.perform import Motion
from prbench.synthetic.people.plan import OPENING
from prbench.synthetic.people.walking import plan_steps
from prbench.synthetic.performance import ObjectMotion, Performance, TrueEvent


class _Phrases(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``phrases.toml``."""

    clauses: dict[str, tuple[str, ...]]
    body_posture: dict[str, str]
    legs: dict[str, str]
    doing: dict[str, str]


_PHRASES = read_toml("prbench.synthetic.activities", "phrases.toml", _Phrases)
PATTERNS: Mapping[str, tuple[str, ...]] = MappingProxyType(_PHRASES.clauses)

# Metres a second: somebody walks slowly below the first and briskly above the second.
SLOW = 0.7
_BRISK = 1.25
# Degrees: somebody turns slightly below the first and around above the second.
_SLIGHT = 60.0
_AROUND = 135.0
# Degrees of heading that make a walk a walk to one side.
_CURVED = 25.0

_HANDS = {0: "the left hand", 1: "the right hand", 2: "both hands"}
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")
_SUBJECTS = ("C", "The person")
_OTHER_SUBJECT = 0.2


# Name of an activity, and the words that fill the slots of its patterns.
Facts = tuple[str, Mapping[str, str]]


def _facts_of(script: Script, motion: Motion, act: Act, rate: float) -> Facts:
    """Measure what an activity's words depend on; ``walk`` becomes ``walk straight`` or ``walk turning`` so."""
    span = slice(round(act.begin * rate), min(round(act.end * rate), len(motion.joints) - 1) + 1)
    joints = motion.joints[span]
    heading = motion.base.heading[span]
    name = act.name
    slots = {"hand": "" if act.hand is None else _HANDS[act.hand]}
    turned = float(np.rad2deg(heading[-1] - heading[0]))
    moved = joints[-1, Joint.PELVIS] - joints[0, Joint.PELVIS]
    if name in ("walk", "curve"):
        # The median speed of the pelvis over the frames in which it moves at more than half of its fastest, m/s.
        tenth = max(1, round(rate / 10.0))
        speed = np.linalg.norm(np.diff(joints[::tenth, Joint.PELVIS][:, [0, 2]], axis=0), axis=1) * rate / tenth
        slots["speed"] = speed_word(float(np.median(speed[speed > 0.5 * speed.max()])))
        steps = sum(act.begin <= step.lift < act.end for step in plan_steps(script.person, script.segments))
        slots["steps"] = _COUNTS[steps] if 2 <= steps < len(_COUNTS) else "several"
    if name == "walk":
        name = "walk straight" if abs(turned) < _CURVED else "walk turning"
    if name in ("walk turning", "curve", "turn"):
        slots |= _sides(turned > 0.0) | {"amount": amount_word(abs(turned))}
    elif name == "sidestep":
        left = np.array([np.cos(heading[0]), 0.0, -np.sin(heading[0])])
        slots |= _sides(bool(moved @ left > 0.0)) | {"distance": _distance_word(float(abs(moved @ left)))}
    elif name == "step back":
        slots["distance"] = _distance_word(float(np.hypot(moved[0], moved[2])))
    elif name == "look around":
        head = motion.head.yaw[span] - heading
        wide = np.flatnonzero(np.abs(head) > np.deg2rad(20.0))
        slots |= _sides(bool(head[wide[0]] > 0.0) if wide.size else True)
    elif name == "reach" and act.hand is not None:
        slots["height"] = _reach_height(joints, act.hand)
    elif name == "scratch head":
        slots |= _sides(act.hand == 0)
    return name, slots


def clause(facts: Facts, rng: np.random.Generator) -> str:
    """Draw one of the patterns of an activity and fill its slots."""
    name, slots = facts
    filled = PATTERNS[name][int(rng.integers(len(PATTERNS[name])))].format_map(slots)
    return re.sub(r"\s+([,.])", r"\1", re.sub(r"\s+", " ", filled)).strip()


def sentence(clauses: list[str], rng: np.random.Generator) -> str:
    """Put a subject before the clauses; two activities are joined by "then"."""
    subject = _SUBJECTS[int(rng.random() < _OTHER_SUBJECT)]
    return f"{subject} {', then '.join(clauses)}."


def speed_word(speed: float) -> str:
    """Return ``slowly``, ``briskly`` or nothing."""
    if speed < SLOW:
        return "slowly"
    return "briskly" if speed > _BRISK else ""


def amount_word(degrees: float) -> str:
    """Return the word for how far somebody turns."""
    if degrees < _SLIGHT:
        return "slightly"
    return "around" if degrees > _AROUND else ""


def _sides(left: bool) -> dict[str, str]:
    side, other = ("left", "right") if left else ("right", "left")
    return {"side": side, "otherside": other, "sidewards": f"to the {side}"}


def _distance_word(metres: float) -> str:
    if metres < 0.35:
        return "a small"
    return "a" if metres < 0.5 else "a big"


def _reach_height(joints: np.ndarray, hand: int) -> str:
    """Return in words where the wrist is when it is farthest from the shoulder's vertical."""
    wrist = joints[:, WRISTS[hand]]
    shoulder = joints[:, Joint.LEFT_SHOULDER + hand]
    frame = int(np.linalg.norm((wrist - joints[:, Joint.PELVIS])[:, [0, 2]], axis=1).argmax())
    height = float(wrist[frame, 1])
    if height > float(shoulder[frame, 1]) + 0.1:
        return "high up"
    return "low down" if height < float(joints[frame, Joint.PELVIS, 1]) - 0.12 else "forward"


@dataclass(frozen=True)
class TrueNarration:
    """One span of text.

    Attributes:
        start: Seconds from the recording's first frame.
        texts: One for each answer of the kind.
        activities: What happens, by name; for checks, never written.
    """

    kind: Literal["atomic_action", "motion_narration", "activity_summarization"]
    start: float
    end: float
    texts: tuple[str, ...]
    activities: tuple[str, ...]


@dataclass(frozen=True)
class NarratedMotion:
    """One recording of the corpus, noise-free. Metres, Y up, floor at y = 0; quaternions w x y z, segment to world.

    Attributes:
        rotations: See :class:`prbench.synthetic.performance.Performance`.
        head_rotation: True head: x left, y up, z forward.
    """

    recording_id: str
    participant_id: str
    split: Literal["train", "validation", "test"]
    rate: float
    joints: Float[np.ndarray, "n 22 3"]
    rotations: Float[np.ndarray, "n 22 4"]
    head_rotation: Float[np.ndarray, "n 4"]
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


def narrate(script: Script, motion: Motion, rate: float, rng: np.random.Generator) -> tuple[TrueNarration, ...]:
    """Describe every activity in words, from what the body did.

    Args:
        script: What was planned, for names and times.
        motion: What happened.
        rate: Frames a second.
        rng: Generator of the choice of words.
    """
    facts = [(act, _facts_of(script, motion, act, rate)) for act in script.acts]
    # One row an activity; two short neighbours may share one.
    atomic = []
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
        end = min(max(end, min(act.begin + _SHORTEST, latest)), act.begin + _LONGEST)
        text = sentence([clause(each, rng) for each in told], rng)
        atomic.append(TrueNarration("atomic_action", act.begin, end, (text,), tuple(name for name, _ in told)))
    about_body = [_about_body(act, fact) for act, fact in facts if act.end - act.begin >= 2.0]
    # What happened in stretches of 15 to 30 seconds.
    narrations: list[TrueNarration] = []
    begin: float | None = None
    doing: list[str] = []
    for act, (name, _) in facts:
        begin = act.begin if begin is None else begin
        doing.append(_PHRASES.doing[name])
        if act.end - begin >= _SUMMARY:
            names = list(dict.fromkeys(doing))
            text = f"C {', '.join(names[:-1])} and {names[-1]}." if len(names) > 1 else f"C {names[0]}."
            narrations.append(TrueNarration("activity_summarization", begin, act.end, (text,), tuple(names)))
            begin = None
            doing = []
    return (*atomic, *about_body, *narrations)


def _about_body(act: Act, fact: Facts) -> TrueNarration:
    name, slots = fact
    hand = slots.get("hand", "")
    arms = f"C moves {hand}." if hand else "C keeps both arms at rest."
    if name in ("raise arms", "look at hands"):
        arms = "C lifts both arms."
    texts = (
        f"C {_PHRASES.body_posture.get(name, 'stands upright')}.",
        arms,
        f"C {_PHRASES.legs.get(name, 'keeps both feet in place')}.",
        "C looks from side to side." if name == "look around" else "C looks ahead.",
    )
    return TrueNarration("motion_narration", act.begin, min(act.end, act.begin + _LONGEST), texts, (name,))


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
    narrations: list[TrueNarration] = []
    # The seconds of standing before anything happens; seated people have no words here.
    first_movement = min([OPENING, *(event.motor_start for event in performance.events)])
    knees = performance.joints[0, [Joint.LEFT_KNEE, Joint.RIGHT_KNEE], 1].mean()
    if performance.joints[0, Joint.PELVIS, 1] >= 1.4 * knees:
        text = sentence([clause(("stand", {}), rng)], rng)
        narrations.append(TrueNarration("atomic_action", _FIRST_TEXT, first_movement, (text,), ("stand",)))
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


def _goal_facts(performance: Performance, event: TrueEvent, since: float) -> Facts:
    """Return what the words for a pick or put depend on.

    Args:
        performance: Who did it.
        event: What was done.
        since: Time from which on manners count, seconds.
    """
    first, last = np.searchsorted(performance.times, [since, event.event_time])
    joints = performance.joints[first : max(int(last), int(first) + 2)]
    # The furniture under the goal, and whether it is low or high.
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
    # Where the goal lies, seen from the body at the event.
    pelvis = joints[-1, Joint.PELVIS]
    bearing = np.arctan2(event.goal[0] - pelvis[0], event.goal[2] - pelvis[2]) - facing_yaw(joints[-1])
    bearing = (bearing + np.pi) % (2.0 * np.pi) - np.pi
    side = "left" if bearing > 0 else "right"
    if abs(bearing) <= _BESIDE:
        side = f"{event.hand} hand side"
    manner = "slowly" if event.contact_time - event.reach_start > _SLOW_REACH else ""
    if float(np.linalg.norm((joints[-1] - joints[0])[Joint.PELVIS, [0, 2]])) > _WALKED:
        manner = "after walking over"
    what = {"thing": f"the {spoken_name(event.object_name)}", "place": f"the {height}{name}"}
    return event.action, what | {"hand": f"the {event.hand} hand", "side": side, "manner": manner}


def spoken_name(name: str) -> str:
    """Return ``cup_red`` and ``BlackCeramicMug`` as people say them: red cup, black ceramic mug."""
    words = re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name.replace("_", " "))
    words = [word.lower() for word in words]
    colours = {"red", "green", "blue", "pink", "white", "black", "bamboo"}
    if len(words) == 2 and words[1] in colours:
        words.reverse()
    return " ".join(words)


def _distance_to_top(item: ObjectMotion, point: np.ndarray) -> float:
    """Return the distance of a point from the rectangle on top of a box that stands along the walls."""
    w, _, y, _ = item.rotation[0]
    yaw = 2.0 * np.arctan2(y, w)
    offset = point - item.position[0]
    along = offset[0] * np.cos(yaw) - offset[2] * np.sin(yaw)
    across = offset[0] * np.sin(yaw) + offset[2] * np.cos(yaw)
    beyond = np.maximum(np.abs([along, across]) - item.half_extents[[0, 2]], 0.0)
    return float(np.hypot(*beyond) + abs(offset[1] - item.half_extents[1]))
