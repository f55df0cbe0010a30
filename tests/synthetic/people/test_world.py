"""Who acts where, and on which side of the split."""

from __future__ import annotations

from typing import Literal

import pytest

from prbench.synthetic.people.world import Assignment, Source, assign


def castings(count: int, world: Literal["default", "large"] = "default") -> list[Assignment]:
    source = Source(3, "adt", world)
    return [assign(source, index) for index in range(count)]


@pytest.mark.parametrize("world", ["default", "large"])
def test_no_test_person_and_no_test_room_occurs_in_training(world: Literal["default", "large"]) -> None:
    drawn = castings(600, world)
    test = [casting for casting in drawn if casting.split == "test"]
    other = [casting for casting in drawn if casting.split != "test"]
    assert not {c.person for c in test} & {c.person for c in other}
    assert not {c.room for c in test} & {c.room for c in other}


def test_validation_people_do_not_train() -> None:
    drawn = castings(600)
    assert not {c.person for c in drawn if c.split == "validation"} & {c.person for c in drawn if c.split == "train"}


def test_thirty_percent_are_test_recordings() -> None:
    share = sum(casting.split == "test" for casting in castings(1000)) / 1000
    assert share == pytest.approx(0.30, abs=0.04)


def test_a_small_world_has_24_people_and_12_rooms() -> None:
    drawn = castings(600)
    assert len({c.person for c in drawn}) == 24
    assert len({c.room for c in drawn}) == 12
