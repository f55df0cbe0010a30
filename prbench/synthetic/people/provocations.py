"""Movements that test one decision of curation each (docs/specification/synthetic-recordings.md#provocations)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from prbench.errors import UsageError
from prbench.synthetic.people.presets import ObjectKind, Preset

EXTRA = ("pass_by", "touch", "nudge", "hinge")
"""Movements of their own, before a pick."""
OF_PAIR = ("two_handed", "hand_over", "same_place", "contained")
"""Ways to pick something and to put it."""
OF_EVENT = ("too_near", "early", "swept", "lost")
"""Circumstances of a single event."""
OF_OTHERS = ("bystander",)
TAGS = (*EXTRA, *OF_PAIR, *OF_EVENT, *OF_OTHERS)

DEFAULT_SHARE = 0.10
"""Of the movements, for all tags together."""

TRAY = ObjectKind("WoodenTray", "tray", (0.13, 0.015, 0.10))
TRAY_HANDLE = np.array([0.0, 0.0, -0.075])
"""Where the tray is held, in its own frame; what it carries stands on the other side."""
TRAY_LOAD = np.array([0.0, 0.0, 0.05])
DOOR = ObjectKind("CabinetDoor", "door", (0.16, 0.20, 0.010))
DOOR_HANDLE = np.array([-0.13, 0.0, 0.005])
"""The hinge is at x = + half extent; the front looks along -z of the door's frame."""
HANDLE_HALF = np.array([0.025, 0.02, 0.025])


def shares_for(preset: Preset, wanted: Mapping[str, float] | None) -> dict[str, float]:
    """The share of each tag that can happen in a preset.

    Args:
        preset: Decides which tags are possible: nothing is put down in gimo, only adt records other people.
        wanted: Share of the movements for each tag; None: 10 % together.

    Raises:
        UsageError: if a tag is unknown or a share lies outside [0, 1].
    """
    possible = possible_tags(preset)
    if wanted is None:
        return {tag: DEFAULT_SHARE / len(possible) for tag in possible}
    for tag, share in wanted.items():
        if tag not in TAGS:
            raise UsageError(f"provocation '{tag}' is unknown. Take some of: {', '.join(TAGS)}.")
        if not 0.0 <= share <= 1.0:
            raise UsageError(f"provocation '{tag}': expected a share from 0 to 1, found {share}.")
    return {tag: wanted[tag] for tag in possible if wanted.get(tag, 0.0) > 0.0}


def possible_tags(preset: Preset) -> tuple[str, ...]:
    """The tags that make sense in a preset."""
    if not preset.puts:
        return ("pass_by", "touch", "too_near", "early", "swept")
    without = set() if preset.name == "adt" else {"bystander"}
    if preset.table_only:
        without.add("hinge")
    return tuple(tag for tag in TAGS if tag not in without)


def draw_tag(shares: Mapping[str, float], movements: int, is_first: bool, rng: np.random.Generator) -> str:
    """The tag of the next pick (and its put), or ``plain``.

    Args:
        shares: Of the movements, for each tag.
        movements: Events that the tag stands for: two where everything picked is put.
        is_first: Whether these are the recording's first events; only they can be ``early``.
        rng: Of the provocations.
    """
    chance = rng.random()
    for tag, share in shares.items():
        if tag in OF_OTHERS:
            continue
        chance -= share * movements
        if chance < 0.0:
            return "plain" if tag == "early" and not is_first else tag
    return "plain"
