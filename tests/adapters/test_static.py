"""Static: the mean training pose, held still."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.contract import Adapter, Condition, ConditionBatch, Trainable, TrainingRun
from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint
from prbench.sequences import SequenceTable
from prbench_adapters.static import load
from tests.fakes import fake_dataset, fake_sequence


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> SequenceTable:
    return fake_dataset(tmp_path_factory.mktemp("static") / "d", 24)


def asked_for(*n_frames: int) -> ConditionBatch:
    return ConditionBatch(
        condition=Condition.NONE,
        n_frames=np.array(n_frames),
        fps=20.0,
        opaque_id=tuple(map(str, n_frames)),
        noise_seed=n_frames,
    )


def fitted(table, folder, **options):
    static = load(None, options=options, device="cpu")
    static.fit(table, validation=None, run=TrainingRun(folder, seed=0, device="cpu"))
    return static


def test_the_pose_is_the_mean_over_all_training_frames_and_no_others(table, tmp_path):
    rows = [fake_sequence(i) for i in range(24)]
    expected = np.concatenate([row.joints for row in rows if row.split == "train"]).mean(axis=0, dtype=np.float64)
    static = fitted(table, tmp_path)
    assert isinstance(static, Adapter)
    assert isinstance(static, Trainable)
    assert static.conditions == {Condition.NONE}
    motions = static.generate(asked_for(5, 3), seed=0)
    assert motions.joints.shape == (2, 5, 22, 3)
    assert list(motions.n_frames) == [5, 3]
    assert np.allclose(motions.joints, expected, atol=1e-9)


def test_pose_only_puts_the_pelvis_over_the_origin_and_keeps_the_pose(table, tmp_path):
    plain = fitted(table, tmp_path / "a").generate(asked_for(1), seed=0).joints[0, 0]
    pose = fitted(table, tmp_path / "b", **{"pose-only": "true"}).generate(asked_for(1), seed=0).joints[0, 0]
    assert np.allclose(pose[Joint.PELVIS, [0, 2]], 0.0)
    assert np.allclose(pose - pose[0], plain - plain[0])
    assert np.allclose(pose[:, 1], plain[:, 1])


def test_a_second_fit_takes_what_the_first_one_left(table, tmp_path):
    first = fitted(table, tmp_path).generate(asked_for(1), seed=0)
    static = load(None, options={}, device="cpu")
    nowhere = SequenceTable(tmp_path / "gone", table.info)
    static.fit(nowhere, validation=None, run=TrainingRun(tmp_path, seed=0, device="cpu"))
    assert np.array_equal(static.generate(asked_for(1), seed=0).joints, first.joints)


def test_a_table_without_training_sequences_motions_before_a_fit_and_weights_are_refused(tmp_path):
    table = fake_dataset(tmp_path / "d", 2, recordings=12)
    only_test = SequenceTable(tmp_path / "d", table.info)
    object.__setattr__(only_test, "chunks", lambda **_: iter(()))
    with pytest.raises(AdapterError, match=r"none in split 'train'"):
        fitted(only_test, tmp_path / "fit")
    with pytest.raises(AdapterError, match=r"before it was fitted"):
        load(None, options={}, device="cpu").generate(asked_for(1), seed=0)
    with pytest.raises(ValueError, match=r"has no weights"):
        load(tmp_path, options={}, device="cpu")
