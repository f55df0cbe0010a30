"""Words for what truly happened: sides, speeds and angles are measured on the motion, never taken from the plan."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import WRISTS, Joint
from prbench.synthetic.activities.patterns import PATTERNS

SLOW = 0.7
_BRISK = 1.25
"""Metres a second: below it somebody walks slowly, above it briskly."""
_SLIGHT = 60.0
_AROUND = 135.0
"""Degrees: below it somebody turns slightly, above it around."""
_CURVED = 25.0
"""Degrees of heading that make a walk a walk to one side."""

_HANDS = {0: "the left hand", 1: "the right hand", 2: "both hands"}
_COUNTS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight")
_SUBJECTS = ("C", "The person")
_OTHER_SUBJECT = 0.2


@dataclass(frozen=True)
class Facts:
    """Measurements of one activity."""

    name: str
    slots: Mapping[str, str]


@dataclass(frozen=True)
class Span:
    """A stretch of a motion to be described: joints (n, 22, 3) and the steps taken in it."""

    joints: Float[np.ndarray, "n 22 3"]
    heading: Float[np.ndarray, " n"]
    """Of the pelvis, unwrapped, radians; > 0 turns left."""
    head_yaw: Float[np.ndarray, " n"]
    """Of the head against the pelvis, radians; > 0 looks left."""
    rate: float
    steps: int


def facts_of(name: str, hand: int | None, span: Span) -> Facts:
    """Measure what an activity's words depend on.

    Args:
        name: Activity as planned; ``walk`` becomes ``walk straight`` or ``walk turning`` by what happened.
        hand: 0 left, 1 right, 2 both; None where no hand matters.
        span: The motion.
    """
    slots = {"hand": "" if hand is None else _HANDS[hand]}
    turned = float(np.rad2deg(span.heading[-1] - span.heading[0]))
    if name in ("walk", "curve"):
        slots |= {"speed": speed_word(walking_speed(span)), "steps": _COUNTS[min(span.steps, len(_COUNTS) - 1)]}
        slots["steps"] = "several" if span.steps >= len(_COUNTS) or span.steps < 2 else slots["steps"]
    if name == "walk":
        name = "walk straight" if abs(turned) < _CURVED else "walk turning"
    if name in ("walk turning", "curve", "turn"):
        slots |= _sides(turned > 0.0) | {"amount": amount_word(abs(turned))}
    elif name == "sidestep":
        moved = span.joints[-1, Joint.PELVIS] - span.joints[0, Joint.PELVIS]
        left = np.array([np.cos(span.heading[0]), 0.0, -np.sin(span.heading[0])])
        slots |= _sides(bool(moved @ left > 0.0)) | {"distance": _distance_word(float(abs(moved @ left)))}
    elif name == "step back":
        moved = span.joints[-1, Joint.PELVIS] - span.joints[0, Joint.PELVIS]
        slots["distance"] = _distance_word(float(np.hypot(moved[0], moved[2])))
    elif name == "look around":
        wide = np.flatnonzero(np.abs(span.head_yaw) > np.deg2rad(20.0))
        slots |= _sides(bool(span.head_yaw[wide[0]] > 0.0) if wide.size else True)
    elif name == "reach" and hand is not None:
        slots["height"] = _reach_height(span.joints, hand)
    elif name == "scratch head":
        slots |= _sides(hand == 0)
    return Facts(name, slots)


def clause(facts: Facts, rng: np.random.Generator) -> str:
    """Draw one of the patterns of an activity and fill its slots."""
    patterns = PATTERNS[facts.name]
    filled = patterns[int(rng.integers(len(patterns)))].format_map(facts.slots)
    return re.sub(r"\s+([,.])", r"\1", re.sub(r"\s+", " ", filled)).strip()


def sentence(clauses: list[str], rng: np.random.Generator) -> str:
    """Put a subject before the clauses; two activities are joined by "then"."""
    subject = _SUBJECTS[int(rng.random() < _OTHER_SUBJECT)]
    return f"{subject} {', then '.join(clauses)}."


def walking_speed(span: Span) -> float:
    """Return the median speed of the pelvis over the frames in which it moves at more than half of its fastest, m/s."""
    tenth = max(1, round(span.rate / 10.0))
    way = np.diff(span.joints[::tenth, Joint.PELVIS][:, [0, 2]], axis=0)
    speed = np.linalg.norm(way, axis=1) * span.rate / tenth
    return float(np.median(speed[speed > 0.5 * speed.max()]))


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
    out = np.linalg.norm((wrist - joints[:, Joint.PELVIS])[:, [0, 2]], axis=1)
    frame = int(out.argmax())
    height = float(wrist[frame, 1])
    if height > float(shoulder[frame, 1]) + 0.1:
        return "high up"
    return "low down" if height < float(joints[frame, Joint.PELVIS, 1]) - 0.12 else "forward"
