"""Which room and which person a recording gets, and on which side of the split.

Source: docs/specification/synthetic-recordings.md#determinism-splits-sizes. The numbers of rooms and people belong to
the world, so that recording i depends on (seed, preset, world, i) alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from prbench.randomness import named_generator
from prbench.synthetic import GENERATOR_VERSION

TEST_SHARE, VALIDATION_SHARE = 0.30, 0.10

World = Literal["default", "large"]
SplitRule = Literal["person_and_room", "recording"]
Split = Literal["train", "validation", "test"]

_PEOPLE = {"default": 24, "large": 400}
_ROOMS = {"default": 12, "large": 200}


@dataclass(frozen=True)
class Source:
    """Names every generator of one preset and world."""

    seed: int
    preset: str
    world: World

    def generator(self, kind: str, index: int, purpose: str) -> np.random.Generator:
        """The stream of one thing and one purpose; independent of every other."""
        return named_generator(
            "prbench-synth", GENERATOR_VERSION, self.seed, self.preset, self.world, kind, index, purpose
        )


@dataclass(frozen=True)
class Casting:
    """Room, person and split of one recording."""

    room: int
    person: int
    split: Split


def cast(source: Source, index: int, rule: SplitRule) -> Casting:
    """Draw the side of the split, then room and person.

    Args:
        source: Seed, preset and world.
        index: Of the recording.
        rule: ``person_and_room`` keeps people and rooms of the test side out of training; ``recording`` reproduces
            the study's split by recording, with its leakage.
    """
    rng = source.generator("recording", index, "split")
    chance = rng.random()
    people, rooms = _ranked(source, "person"), _ranked(source, "room")
    if rule == "recording":
        person, room = people[int(rng.integers(len(people)))], rooms[int(rng.integers(len(rooms)))]
        split = "test" if chance < TEST_SHARE else "validation" if chance < TEST_SHARE + 0.07 else "train"
        return Casting(room, person, split)
    n_test_people, n_test_rooms = round(TEST_SHARE * len(people)), round(TEST_SHARE * len(rooms))
    is_test = chance < TEST_SHARE
    people_here = people[:n_test_people] if is_test else people[n_test_people:]
    rooms_here = rooms[:n_test_rooms] if is_test else rooms[n_test_rooms:]
    person = people_here[int(rng.integers(len(people_here)))]
    room = rooms_here[int(rng.integers(len(rooms_here)))]
    for_validation = people[n_test_people : n_test_people + round(VALIDATION_SHARE * len(people))]
    split = "test" if is_test else "validation" if person in for_validation else "train"
    return Casting(room, person, split)


def _ranked(source: Source, kind: str) -> list[int]:
    """All people or rooms of the world in the order of a hash."""
    count = (_PEOPLE if kind == "person" else _ROOMS)[source.world]
    return [int(number) for number in source.generator(kind, 0, "rank").permutation(count)]
