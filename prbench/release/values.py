"""Parse values of ``target_information.json`` in all forms that occur; None stands for a value of another kind."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

SUBSETS = {
    "train": "train", "training": "train", "tr": "train",
    "test": "test", "testing": "test", "te": "test",
    "val": "validation", "validation": "validation",
}  # fmt: skip
_ACTION_WORDS = {
    "pick": "pick", "grab": "pick", "take": "pick",
    "put": "put", "place": "put", "drop": "put",
}  # fmt: skip
_PICKS = re.compile(r"\b(pick|grab|take|taking|took|lift|fetch)", re.IGNORECASE)
_PUTS = re.compile(r"\b(put|plac|drop|set(s|ting)? down|return)", re.IGNORECASE)
_DEEPEST = 2  # lists within the list of a goal
_HANDS = {"left": "left", "l": "left", "right": "right", "r": "right"}


@dataclass(frozen=True)
class Goal:
    """A goal, in the frame and unit of the release."""

    location: Float[np.ndarray, "3"]
    box: Float[np.ndarray, "2 3"] | None
    """Lower and upper corner, where the release gives a box."""


def parse_goal(value: Any) -> Goal | None:
    """Parse a point (list, nested list, text, ``{x, y, z}``) or a box (six numbers, ``{min, max}``).

    The location of a box is its centre.
    """
    if isinstance(value, dict):
        named = {str(name).lower(): part for name, part in value.items()}
        if {"min", "max"} <= set(named):
            value = [named["min"], named["max"]]
        elif {"x", "y", "z"} <= set(named):
            value = [named["x"], named["y"], named["z"]]
        else:
            return None
    numbers = _numbers(value)
    if numbers is None or numbers.size not in (3, 6):
        return None
    if numbers.size == 3:
        return Goal(numbers, None)
    box = numbers.reshape(2, 3)
    return Goal(box.mean(axis=0), box)


def _numbers(value: Any, *, depth: int = 0) -> np.ndarray | None:
    """Return all finite numbers of a list, nested list or text; None if there is anything else in it."""
    if isinstance(value, str):
        value = re.split(r"[\s,;]+", value.strip(" ()[]{}\t\n"))
    if not isinstance(value, list | tuple) or depth > _DEEPEST:
        return None
    flat = list[float]()
    for part in value:
        inner = _numbers(part, depth=depth + 1) if isinstance(part, list | tuple) else parse_number(part)
        if inner is None:
            return None
        flat += np.ravel(inner).tolist()
    return np.array(flat, dtype=np.float64)


def parse_number(value: Any) -> float | None:
    """Parse a finite number, also one written as text; truth values are no numbers."""
    # In Python True is an int; in a release it is no number.
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def parse_text(value: Any) -> str | None:
    """Parse a sentence, which is text with a space in it; of a list the first element."""
    if isinstance(value, list) and value:
        return parse_text(value[0])
    return value.strip() if isinstance(value, str) and " " in value.strip() else None


def parse_subset(value: Any, field: str = "") -> str | None:
    """Parse ``train``, ``test`` or ``validation``; truth values too, where the field's name says what is true."""
    if isinstance(value, str):
        named = SUBSETS.get(value.strip().lower())
        if named is not None or value.strip().lower() not in ("0", "1", "true", "false"):
            return named
        value = value.strip().lower() in ("1", "true")
    if isinstance(value, bool) or value in (0, 1):
        name = field.lower()
        # `is_train: 1` says something, `split: 1` does not.
        if ("train" in name) != ("test" in name):
            is_train = bool(value) == ("train" in name)
            return "train" if is_train else "test"
    return None


def parse_action(value: Any, field: str = "") -> str | None:
    """Parse ``pick`` or ``put`` from a word, or from 0/1 where the field's name says what is true."""
    if isinstance(value, str):
        word = value.strip().lower()
        return next((action for start, action in _ACTION_WORDS.items() if word.startswith(start)), None)
    if isinstance(value, bool) or value in (0, 1):
        name = field.lower()
        if ("pick" in name) != ("put" in name):
            return "pick" if bool(value) == ("pick" in name) else "put"
    return None


def action_of_text(text: str) -> str | None:
    """Return ``pick`` or ``put`` as a prompt says it; None where it says both or neither."""
    picks = bool(_PICKS.search(text))
    # `Take the cup and put it down` names both.
    if picks == bool(_PUTS.search(text)):
        return None
    return "pick" if picks else "put"


def parse_hand(value: Any) -> str | None:
    """Parse ``left`` or ``right``, also by their first letters."""
    return _HANDS.get(value.strip().lower()) if isinstance(value, str) else None


def parse_name(value: Any) -> str | None:
    """Parse a name or id as text."""
    if isinstance(value, bool) or not isinstance(value, str | int):
        return None
    return str(value).strip() or None
