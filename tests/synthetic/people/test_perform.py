"""What the arguments of a performance decide; equal ones give equal bytes (tests/laws/synthetic_cases.py)."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.synthetic.people import perform
from prbench.synthetic.performance import Performance


def act(index: int, **changes: object) -> Performance:
    arguments: dict = {"seed": 11, "index": index, "n_events": 4, "rate": 30.0} | changes
    return perform("adt", **arguments)


def test_the_rate_changes_how_often_a_recording_is_sampled_not_what_happens() -> None:
    slow, fast = act(4), act(4, rate=60.0)
    assert [e.event_id for e in slow.events] == [e.event_id for e in fast.events]
    joints = fast.joints[::2][: len(slow.joints)]
    assert np.abs(joints - slow.joints[: len(joints)]).max() < 0.05


def test_ids_are_sixteen_digits_and_distinct_within_a_recording() -> None:
    ids = [item.object_id for item in act(4).objects]
    assert len(set(ids)) == len(ids)
    assert all(len(number) == 16 and number.isdecimal() for number in ids)


def test_as_many_bystander_objects_as_asked_for() -> None:
    untouched = [item for item in act(4, bystander_objects=40).objects if item.movable and len(item.position) == 1]
    assert len(untouched) >= 40


def test_unknown_presets_are_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError, match="hd-epic"):
        perform("adtt", seed=0, index=0)
