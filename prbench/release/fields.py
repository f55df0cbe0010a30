"""Find the meaning of a release's fields: by exact alias, then by part of a name, then by the form of the values."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from prbench.errors import InputFileError, UsageError
from prbench.release.known import letters
from prbench.release.report import Certainty, FieldChoice
from prbench.release.values import (
    parse_action,
    parse_goal,
    parse_hand,
    parse_name,
    parse_number,
    parse_subset,
    parse_text,
)

_LOOKED_AT = 200  # values of a field on which its form is judged
_FITTING = 0.8  # share of them that must have the form: a few broken entries do not change what a field means


@dataclass(frozen=True)
class _FieldRule:
    """The signs of one canonical field (docs/specification/pr-release.md#tolerant-parser)."""

    canonical: str
    aliases: tuple[str, ...]
    fits: Callable[[Any, str], bool]
    """Returns True if a value has the right form; called with the value and the field's name."""
    part: str | None = None
    """Pattern within a name (letters and digits only); None for fields on which no number depends."""
    by_value: bool = False
    """A field is recognised by its values alone, if nothing else is."""
    required: bool = False


def _is_frame_rate(value: Any, _name: str) -> bool:
    number = parse_number(value)
    return number is not None and 5 <= number <= 240


def _is_number(value: Any, _name: str) -> bool:
    return parse_number(value) is not None


def _is_name(value: Any, _name: str) -> bool:
    return parse_name(value) is not None


FIELDS: tuple[_FieldRule, ...] = (
    _FieldRule(
        "goal",
        ("goal", "goallocation", "goalposition", "goalpos", "target", "targetlocation", "targetposition",
         "objectlocation", "objectposition", "objectpos", "location", "position", "o3d", "loc3d"),
        lambda value, _: parse_goal(value) is not None,
        part="goal|target|object.*(loc|pos|cent)|(loc|pos|cent).*object",
        by_value=True,
        required=True,
    ),
    _FieldRule(
        "text",
        ("text", "prompt", "textprompt", "caption", "description", "narration", "instruction", "sentence"),
        lambda value, _: parse_text(value) is not None,
        part="text|prompt|caption",
        by_value=True,
    ),
    _FieldRule(
        "subset",
        ("subset", "split", "set", "partition", "phase", "mode", "traintest", "istrain", "train", "test"),
        lambda value, name: parse_subset(value, name) is not None,
        part="split|subset|train|test",
        by_value=True,
        required=True,
    ),
    _FieldRule("fps", ("fps", "framerate"), _is_frame_rate, part="fps"),
    _FieldRule("num_frames", ("numframes", "nframes", "framecount", "length", "numberofframes"), _is_number),
    _FieldRule("duration", ("duration", "durations", "seconds"), _is_number),
    _FieldRule("event_frame", ("eventframe", "eventidx", "eventframenumber"), _is_number),
    _FieldRule(
        "primed_frame",
        ("primedframe", "primedframenumber", "primeframe", "primingframe", "primedidx", "primeindex", "tp", "prime",
         "primetime"),
        _is_number,
        part="prim(e|ing)",
        by_value=True,
        required=True,
    ),
    _FieldRule(
        "action",
        ("action", "actiontype", "type", "event", "eventtype", "pickput", "verb"),
        lambda value, name: parse_action(value, name) is not None,
        part="action|pick|put",
        by_value=True,
    ),
    _FieldRule("hand", ("hand", "side", "wrist"), lambda value, _: parse_hand(value) is not None, part="hand"),
    _FieldRule(
        "source",
        ("source", "sourcevideo", "video", "videoid", "videoname", "recording", "recordingid", "clip", "sequencename"),
        _is_name,
    ),
    _FieldRule("object_name", ("objectname", "object", "objectlabel", "noun"), _is_name),
    _FieldRule("object_box", ("objectbox", "goalbox", "targetbox", "bbox", "box", "aabb"),
              lambda value, _: _is_box(value)),
    _FieldRule("units", ("units", "unit"), lambda value, _: isinstance(value, str)),
    _FieldRule("up", ("up", "upaxis"), lambda value, _: isinstance(value, str)),
    _FieldRule("prbench", ("prbench",), lambda value, _: isinstance(value, dict)),
)  # fmt: skip
"""The canonical fields in the order in which they choose; a field of the release gets one meaning only."""


def choose_fields(
    where: str, names: Sequence[str], values: Callable[[str], Sequence[Any]], given: Mapping[str, str]
) -> tuple[FieldChoice, ...]:
    """Decide what each field of a release means.

    Args:
        where: File, for messages.
        names: Fields of the release.
        values: Returns all values of a field.
        given: Maps canonical names to the fields that the user chose for them.

    Raises:
        UsageError: if the user names a field that does not exist.
        InputFileError: if two fields fit equally well, or a field that is needed is not found; lists the names.
    """
    # A sample decides: the parsers are slow, and releases have tens of thousands of entries.
    some = {name: _some(values(name)) for name in names}
    chosen = [_given(where, canonical, field, names) for canonical, field in given.items()]
    for rule in FIELDS:
        taken = {choice.field for choice in chosen}
        if rule.canonical in given:
            continue
        free = [name for name in names if name not in taken]
        choice = _choose(where, rule, free, some)
        if choice is not None:
            chosen.append(choice)
        elif rule.required:
            raise InputFileError(
                where,
                rule.canonical,
                expected="a field that fits",
                found=f"the fields {', '.join(names)}",
                remedy=f"Say which it is: --field-map {rule.canonical}=NAME",
            )
    return tuple(chosen)


def _given(where: str, canonical: str, field: str, names: Sequence[str]) -> FieldChoice:
    known = [rule.canonical for rule in FIELDS]
    if canonical not in known:
        raise UsageError(f"--field-map: there is no field '{canonical}'; there are: {', '.join(known)}.")
    if field not in names:
        raise UsageError(f"--field-map {canonical}={field}: {where} has the fields {', '.join(names)}.")
    return FieldChoice(canonical, field, "certain", "given by --field-map")


def _choose(
    where: str, rule: _FieldRule, free: Sequence[str], values: Mapping[str, Sequence[Any]]
) -> FieldChoice | None:
    part = re.compile(rule.part) if rule.part else None
    steps: tuple[tuple[list[str], Certainty, str], ...] = (
        ([name for name in free if letters(name) in rule.aliases], "certain", "known name"),
        ([name for name in free if part and part.search(letters(name))], "likely", "part of its name, and its values"),
        (list(free) if rule.by_value else [], "assumed", "its values only"),
    )
    for names, certainty, evidence in steps:
        found = [name for name in names if _fits(rule, name, values[name])]
        # Fields like the frame count only confirm; the first alias is as good as any.
        if len(found) > 1 and rule.part is None:  # no number depends on it
            found = sorted(found, key=lambda name: rule.aliases.index(letters(name)))[:1]
        # Guessing between two goals or two splits would silently give a wrong benchmark.
        if len(found) > 1 and (rule.required or certainty == "certain"):
            raise InputFileError(
                where,
                rule.canonical,
                expected="one field that fits",
                found=f"{len(found)}: {', '.join(found)}",
                remedy=f"Say which it is: --field-map {rule.canonical}={found[0]}",
            )
        if len(found) == 1:
            return FieldChoice(rule.canonical, found[0], certainty, evidence)
    return None


def _some(values: Sequence[Any]) -> Sequence[Any]:
    """Return a sample of the values, spread evenly over the field."""
    return values[:: max(1, len(values) // _LOOKED_AT)]


def _fits(rule: _FieldRule, name: str, values: Sequence[Any]) -> bool:
    return bool(values) and sum(rule.fits(value, name) for value in values) >= _FITTING * len(values)


def names_a_field(name: str) -> bool:
    """Return True if a name is an exact alias of some canonical field."""
    return any(letters(name) in rule.aliases for rule in FIELDS)


def _is_box(value: Any) -> bool:
    goal = parse_goal(value)
    return goal is not None and goal.box is not None
