"""Numbers of synthetic people beside their ranges: docs/specification/synthetic-recordings.md#behaviour."""

from __future__ import annotations

from dataclasses import replace

import pytest

from prbench.errors import UsageError
from prbench.protocol.manifests import load_protocol
from prbench.synthetic.people import PRESETS
from tests.synthetic.behaviour import Range, ranges
from tests.synthetic.people_numbers import PeopleNumber, people_numbers

LARGEST_BONE_CHANGE = 0.02
"""Our limit: joints between recorded poses of 30 Hz cut the corner of a swinging leg."""


@pytest.mark.parametrize("preset", PRESETS)
def test_recorded_bodies_keep_their_bones_and_the_protocol(preset: str) -> None:
    numbers = {each.name: each for each in people_numbers(preset, recordings=2, seed=5)}
    assert list(numbers)[: len(ranges(preset))] == list(ranges(preset))
    bones = numbers["bone_change"]
    assert bones.recorded is not None
    assert bones.recorded <= LARGEST_BONE_CHANGE
    assert bones.range.high == load_protocol().metrics.largest_bone_change
    bodies = [each for each in numbers.values() if each.recorded is not None]
    assert len(bodies) == 9
    assert numbers["plausible"].recorded == 1.0
    assert [each.name for each in bodies if not each.holds] == []


def test_a_number_holds_only_if_acted_and_recorded_lie_in_the_range() -> None:
    number = PeopleNumber("adt", "jerk", acted=1.0, recorded=2.0, range=Range(0.0, 2.0, ""))
    assert number.holds
    assert replace(number, recorded=None).holds
    assert not replace(number, acted=2.1).holds
    assert not replace(number, recorded=2.1).holds
    assert not replace(number, acted=float("nan")).holds


def test_a_text_motion_dataset_has_no_people_who_reach() -> None:
    with pytest.raises(UsageError, match=r"expected one of hd-epic, .*, found 'nymeria'"):
        people_numbers("nymeria", recordings=1, seed=0)
