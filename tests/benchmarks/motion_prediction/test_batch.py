from __future__ import annotations

from dataclasses import FrozenInstanceError, dataclass

import numpy as np
import pytest

from prbench.errors import AdapterError, UsageError
from prbench_benchmarks.motion_prediction.batch import (
    Condition,
    Futures,
    ObservedBatch,
    ask,
    sample_generator,
    window_key,
)


def batch(**changes) -> ObservedBatch:
    joints = np.arange(2 * 4 * 1 * 3, dtype=np.float32).reshape(2, 4, 1, 3)
    given = {"condition": Condition.POSE, "observed_joints": joints, "key": (1, 2), "gaze": None, "gaze_valid": None}
    return ObservedBatch(fps=30.0, n_future=6, joint_names=("pelvis",), **(given | changes))


@dataclass(frozen=True)
class Returns:
    joints: np.ndarray
    name: str = "returns"
    conditions: frozenset = frozenset({Condition.POSE})

    def predict(self, batch, *, n_samples, seed):
        return Futures(joints=self.joints)


def test_a_batch_cannot_be_changed_and_leads_to_no_later_frame():
    whole = np.random.default_rng(0).normal(size=(2, 9, 1, 3)).astype(np.float32)
    made = batch(observed_joints=whole[:, :4])
    assert made.observed_joints.base is None
    with pytest.raises(ValueError, match="read-only"):
        made.observed_joints[0] = 0
    with pytest.raises(FrozenInstanceError):
        made.n_future = 3  # type: ignore[misc]


@pytest.mark.parametrize("condition", list(Condition))
def test_gaze_is_given_exactly_where_the_condition_says_so(condition):
    gaze = {"gaze": np.ones((2, 4, 3), np.float32), "gaze_valid": np.ones((2, 4), bool)}
    given, other = (gaze, {}) if condition is not Condition.POSE else ({}, gaze)
    assert batch(condition=condition, **given).condition is condition
    with pytest.raises(ValueError, match="gaze must"):
        batch(condition=condition, **other)


def test_rows_are_complete_in_themselves():
    part = batch().rows(1, 2)
    assert part.key == (2,)
    assert len(part) == 1


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (np.zeros((2, 3, 5, 1, 3)), "expected futures of shape"),
        (np.full((2, 3, 6, 1, 3), np.nan), "finite positions"),
        (np.repeat(np.concatenate([batch().observed_joints] * 2, axis=1)[:, None, :6], 3, axis=1), "observed frames"),
    ],
)
def test_an_answer_that_does_not_fit_is_refused(joints, message):
    with pytest.raises(AdapterError, match=message):
        ask(Returns(joints), batch(), n_samples=3, seed=0)


def test_no_samples_and_a_foreign_condition_are_refused():
    predictor = Returns(np.zeros((2, 3, 6, 1, 3)))
    with pytest.raises(UsageError, match="one sample or more"):
        ask(predictor, batch(), n_samples=0, seed=0)
    gaze = {"gaze": np.ones((2, 4, 3), np.float32), "gaze_valid": np.ones((2, 4), bool)}
    with pytest.raises(UsageError, match=r"does not accept the condition 'pose\+gaze'; it takes: pose"):
        ask(predictor, batch(condition=Condition.POSE_GAZE, **gaze), n_samples=3, seed=0)


def test_the_noise_of_a_sample_depends_on_seed_window_and_sample_alone():
    key = window_key("a/0/sliding/15")
    first = sample_generator(0, key, 3).normal(size=4)
    np.testing.assert_array_equal(first, sample_generator(0, key, 3).normal(size=4))
    for other in ((1, key, 3), (0, key + 1, 3), (0, key, 4)):
        assert (first != sample_generator(*other).normal(size=4)).all()
