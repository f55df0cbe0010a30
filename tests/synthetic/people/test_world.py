"""Who acts where, and on which side of the split."""

from __future__ import annotations

from typing import Literal

import pytest

from prbench.synthetic.people.world import Source, assign


def castings(count: int, world: Literal["default", "large"] = "default") -> list[tuple[int, int, str]]:
    """Room, person and split of some recordings."""
    source = Source(3, "adt", world)
    return [assign(source, index) for index in range(count)]


@pytest.mark.parametrize("world", ["default", "large"])
def test_no_test_person_and_no_test_room_occurs_in_training(world: Literal["default", "large"]) -> None:
    drawn = castings(600, world)
    for kind in (0, 1):
        test = {casting[kind] for casting in drawn if casting[2] == "test"}
        assert not test & {casting[kind] for casting in drawn if casting[2] != "test"}


def test_validation_people_do_not_train() -> None:
    drawn = castings(600)
    people = {split: {person for _, person, own in drawn if own == split} for split in ("train", "validation")}
    assert not people["validation"] & people["train"]


def test_thirty_percent_are_test_recordings() -> None:
    share = sum(split == "test" for _, _, split in castings(1000)) / 1000
    assert share == pytest.approx(0.30, abs=0.04)


def test_a_small_world_has_24_people_and_12_rooms() -> None:
    drawn = castings(600)
    assert len({person for _, person, _ in drawn}) == 24
    assert len({room for room, _, _ in drawn}) == 12
