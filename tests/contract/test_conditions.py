"""The contract that a third party meets: what a batch accepts and what motions mean."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.contract import GIVEN, Adapter, Condition, ConditionBatch, Motions, Trainable


def fields_of(condition: Condition, n: int = 3) -> dict:
    pose = np.arange(n * 66, dtype=np.float32).reshape(n, 22, 3)
    made = {
        "text": tuple("abc"[:n]),
        "initial_joints": pose,
        "previous_joints": pose + 1000,
        "goal_joints": pose + 2000,
        "goal_location": pose[:, 0] + 3000,
    }
    return {name: made[name] for name in GIVEN[condition]}


def batch(condition: Condition, n: int = 3, **changes) -> ConditionBatch:
    common = {
        "condition": condition,
        "n_frames": np.arange(50, 50 + n),
        "fps": 20.0,
        "opaque_id": tuple("xyz"[:n]),
        "noise_seed": tuple(range(n)),
    }
    return ConditionBatch(**{**common, **fields_of(condition, n), **changes})


@pytest.mark.parametrize("condition", Condition)
def test_a_field_that_the_condition_gives_must_be_there(condition):
    for name in GIVEN[condition]:
        with pytest.raises(ValueError, match=rf"'{name}' must be given"):
            batch(condition, **{name: None})


@pytest.mark.parametrize("condition", Condition)
def test_a_field_that_the_condition_does_not_give_must_not_be_there(condition):
    everything = fields_of(Condition.GOAL_POSE) | fields_of(Condition.GOAL_LOCATION)
    for name in everything.keys() - GIVEN[condition]:
        with pytest.raises(ValueError, match=rf"'{name}' must not be given"):
            batch(condition, **{name: everything[name]})


def test_rows_of_different_number_are_refused():
    with pytest.raises(ValueError, match=r"'text' has 2 rows, the batch has 3"):
        batch(Condition.TEXT, text=("a", "b"))
    with pytest.raises(ValueError, match=r"one entry a sequence"):
        batch(Condition.NONE, noise_seed=(1, 2))


@pytest.mark.parametrize("condition", Condition)
def test_a_part_of_a_batch_is_complete_in_itself(condition):
    whole = batch(condition)
    part = whole.rows(1, 3)
    assert len(part) == 2
    for field in dataclasses.fields(part):
        mine, theirs = getattr(part, field.name), getattr(whole, field.name)
        expected = theirs[1:3] if isinstance(theirs, tuple | np.ndarray) else theirs
        assert np.array_equal(mine, expected)


def test_a_batch_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        batch(Condition.NONE).condition = Condition.TEXT  # type: ignore[misc]


def test_motions_leave_their_padding_out():
    joints = np.full((2, 4, 22, 3), np.nan)
    joints[0, :2], joints[1, :4] = 1.0, 2.0
    ragged = Motions(joints, np.array([2, 4])).ragged()
    assert ragged[:, 0, 0].tolist() == [1, 1, 2, 2, 2, 2]


def test_any_object_of_the_right_form_is_an_adapter():
    class Made:
        name = "made"
        conditions = frozenset({Condition.NONE})

        def generate(self, batch, *, seed):
            return Motions(np.zeros((len(batch), 50, 22, 3)), batch.n_frames)

    assert isinstance(Made(), Adapter)
    assert not isinstance(Made(), Trainable)
    assert not isinstance(object(), Adapter)
