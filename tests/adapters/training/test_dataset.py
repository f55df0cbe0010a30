"""Items of a training set: what they hold, what they never hold, and what is refused."""

from __future__ import annotations

import pickle
import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import TableError, UsageError
from prbench.geometry.skeleton import Joint, facing_yaw
from prbench.representation import canonicalise, encode
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.dataset import SequenceDataset
from tests.adapters.training.tables import CAPTIONS, corpus_table, sequence_table


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return sequence_table(tmp_path_factory.mktemp("table") / "t")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return corpus_table(tmp_path_factory.mktemp("corpus") / "c")


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


def rows_of(table, split="train"):
    (chunk,) = table.chunks(split=split)
    return chunk


def distances(points):
    """Between all pairs: what a rigid motion keeps."""
    return np.linalg.norm(points[:, None] - points[None], axis=-1)


def test_an_item_holds_the_row_and_the_features_of_encode(table, cache):
    data, rows = SequenceDataset(table, cache=cache), rows_of(table)
    assert len(data) == len(rows)
    for i, item in enumerate(data[index] for index in range(len(data))):
        joints = rows.joints[rows.offsets[i] : rows.offsets[i + 1]]
        np.testing.assert_array_equal(item.joints, joints)
        np.testing.assert_array_equal(item.features, encode(joints, next_joints=rows.poses("next_joints")[i]))
        np.testing.assert_array_equal(item.initial_joints, joints[0])
        np.testing.assert_array_equal(item.previous_joints, rows.poses("previous_joints")[i])
        np.testing.assert_array_equal(item.goal_joints, joints[-1])
        np.testing.assert_allclose(item.goal_location, rows.vectors("goal_location")[i], atol=1e-6)
        assert (item.sequence_id, item.text) == (rows.sequence_ids[i], rows.strings("text")[i])
        assert (item.n_frames, item.fps) == (len(joints), 20.0)


def test_the_reference_mode_reaches_the_encoder(table, cache):
    def turning(row):
        angle = np.linspace(0, 6 * np.pi, row.n_frames)
        cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
        x, y, z = np.moveaxis(row.joints, -1, 0)
        return replace(row, joints=np.stack([cos * x + sin * z, y, cos * z - sin * x], -1).astype(np.float32))

    spinning = sequence_table(cache / "spinning", 4, change=turning)
    each = {mode: SequenceDataset(spinning, cache=cache, mode=mode)[0].features for mode in ("continuous", "reference")}
    assert np.abs(each["continuous"] - each["reference"]).max() > 1e-3


def test_a_cut_row_ends_with_its_goal_and_starts_canonical(table, cache):
    data, rows = SequenceDataset(table, max_frames=40, cache=cache), rows_of(table)
    for i, item in enumerate(data[index] for index in range(len(data))):
        whole = rows.joints[rows.offsets[i] : rows.offsets[i + 1]]
        first = len(whole) - 40
        assert item.n_frames == 40
        np.testing.assert_allclose(item.joints, canonicalise(whole[first:]), atol=1e-5)
        np.testing.assert_allclose(item.joints[0, Joint.PELVIS, [0, 2]], 0, atol=1e-6)
        assert facing_yaw(item.joints[0]) == pytest.approx(0, abs=1e-6)
        kept = [item.previous_joints, item.joints[0], item.joints[-1], item.goal_location[None]]
        recorded = [whole[first - 1], whole[first], whole[-1], rows.vectors("goal_location")[i][None]]
        np.testing.assert_allclose(distances(np.concatenate(kept)), distances(np.concatenate(recorded)), atol=1e-5)
        one_more = canonicalise(np.concatenate([whole[first:], rows.poses("next_joints")[i : i + 1]]))
        one_more[..., 1] -= one_more[:-1, :, 1].min()
        np.testing.assert_allclose(item.features, encode(one_more[:-1], next_joints=one_more[-1]), atol=1e-4)


def test_random_crops_move_with_the_epoch_and_keep_their_predecessor(corpus, cache):
    data, rows = SequenceDataset(corpus, max_frames=50, crop="random", cache=cache), rows_of(corpus)
    whole = rows.joints[rows.offsets[2] : rows.offsets[3]]
    starts = set()
    for epoch in range(8):
        item = data[2, epoch]
        pose = distances(item.initial_joints)
        (start,) = [n for n, frame in enumerate(whole) if np.allclose(distances(frame), pose, atol=1e-5)]
        starts.add(start)
        before = whole[start - 1] if start else rows.poses("previous_joints")[2]
        pair, recorded = (
            np.concatenate(poses) for poses in ([before, whole[start]], [item.previous_joints, item.initial_joints])
        )
        np.testing.assert_allclose(distances(pair), distances(recorded), atol=1e-5)
        np.testing.assert_allclose(item.joints, canonicalise(whole[start : start + 50]), atol=1e-5)
        assert item.features.shape == (50, 263)
    assert len(starts) > 4


def test_a_draw_depends_on_seed_epoch_and_index_alone(corpus, cache):
    def drawn(seed, order):
        data = SequenceDataset(corpus, max_frames=50, crop="random", seed=seed, cache=cache)
        return {key: data[key] for key in order}

    keys = [(index, epoch) for epoch in range(4) for index in range(3)]
    there, back = drawn(0, keys), drawn(0, keys[::-1])
    for key in keys:
        np.testing.assert_array_equal(there[key].features, back[key].features)
        assert there[key].text == back[key].text
    other = drawn(1, keys)
    assert any(there[key].text != other[key].text for key in keys)


def test_tables_and_corpora_mix_and_corpora_have_no_goal_but_several_captions(table, corpus, cache):
    clips = SequenceDataset(corpus, cache=cache)
    assert {clips[0, epoch].text for epoch in range(40)} == set(CAPTIONS)
    assert clips.texts == tuple(sorted(CAPTIONS))
    data = SequenceDataset([table.folder, corpus], cache=cache)
    alone = SequenceDataset(table, cache=cache)
    assert len(data) == len(alone) + 3
    assert np.isfinite(data[len(alone) - 1].goal_location).all()
    assert np.isnan(data[len(alone)].goal_location).all()
    assert data[-1].sequence_id == "made-up/rec/2"
    assert data.lengths.tolist()[-3:] == [60, 90, 130]


def test_rows_of_another_split_are_never_seen(table, cache):
    for split in ("train", "test"):
        expected = {row["sequence_id"] for row in table.scalars().to_pylist() if row["split"] == split}
        assert set(SequenceDataset(table, split=split, cache=cache).sequence_ids) == expected


def test_a_row_that_cannot_be_encoded_is_left_out_and_told(tmp_path):
    def broken(row):
        if row.split != "train" or row.sequence_id != first:
            return row
        joints = row.joints.copy()
        joints[7, Joint.LEFT_KNEE] = joints[7, Joint.LEFT_HIP]
        return replace(row, joints=joints)

    first = next(row["sequence_id"] for row in sequence_table(tmp_path / "a").scalars(split="train").to_pylist())
    data = SequenceDataset(sequence_table(tmp_path / "b", change=broken), cache=tmp_path / "cache")
    assert first not in data.sequence_ids
    (left_out,) = data.left_out
    assert left_out.sequence_id == first
    assert "frame 7, left_knee" in left_out.reason


def test_a_table_without_one_usable_row_is_refused(tmp_path):
    nothing = sequence_table(tmp_path / "t", change=lambda row: replace(row, joints=row.joints * 0))
    with pytest.raises(TableError, match="cannot be used"):
        SequenceDataset(nothing, cache=tmp_path / "cache")
    assert not list((tmp_path / "cache").glob("*"))


def test_statistics_are_those_of_all_frames(table, cache):
    data = SequenceDataset(table, cache=cache)
    frames = np.concatenate([data[index].features for index in range(len(data))]).astype(np.float64)
    found = data.statistics()
    np.testing.assert_allclose(found.mean, frames.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(found.std[4:67], frames[:, 4:67].std(axis=0).mean(), rtol=1e-4)


@pytest.mark.parametrize(("goal", "size"), [("pose", 198), ("location", 135)])
def test_condition_statistics_are_in_metres_per_second_and_floored(table, cache, goal, size):
    data = SequenceDataset(table, max_frames=40, cache=cache)  # all are cut, so all start over the origin
    mean, std = data.condition_statistics(goal)
    items = [data[index] for index in range(len(data))]
    assert mean.shape == std.shape == (size,)
    velocity = np.stack([(item.initial_joints[5] - item.previous_joints[5]) * 20 for item in items])
    np.testing.assert_allclose(mean[66 + 15 : 66 + 18], velocity.mean(axis=0), atol=1e-5)
    np.testing.assert_allclose(std[66 + 15 : 66 + 18], np.maximum(velocity.std(axis=0), 0.01), rtol=1e-4)
    last = np.stack([item.goal_joints[21] if goal == "pose" else item.goal_location for item in items])
    np.testing.assert_allclose(mean[-3:], last.mean(axis=0), atol=1e-5)
    assert std[[0, 2]].tolist() == pytest.approx([0.01, 0.01])


def test_what_cannot_be_learnt_from_is_refused(table, corpus, cache, tmp_path):
    with pytest.raises(TableError, match="expected a goal location"):
        SequenceDataset(corpus, cache=cache).condition_statistics("location")
    for tables, option, error, message in (
        ([table, corpus_table(tmp_path / "c", fps=30.0)], {}, TableError, r"one frame rate.*20.*30"),
        ([table, table.folder], {}, UsageError, "given twice"),
        (table, {"split": "Train"}, UsageError, "train, validation, test"),
        (table, {"max_frames": 1}, UsageError, "at least 2"),
        (corpus, {"split": "validation"}, TableError, r"'validation', found 3 of 'train'"),
    ):
        with pytest.raises(error, match=message):
            SequenceDataset(tables, cache=cache, **option)


def test_the_set_travels_to_workers_as_paths(table, cache):
    data = SequenceDataset(table, cache=cache)
    packed = pickle.dumps(data)
    assert len(packed) < 10_000 < data[0].features.nbytes
    np.testing.assert_array_equal(pickle.loads(packed)[3].features, data[3].features)


PAGE = Path(__file__).parents[3] / "docs" / "training-data.md"


def test_the_worked_example_learns_and_the_page_names_every_field_of_a_batch(tmp_path):
    (example,) = re.findall(r"```python\n(from itertools.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    names: dict = {}
    exec(example, names)
    table = sequence_table(tmp_path / "t")
    _, before = names["train"](table.folder, steps=1, cache=tmp_path / "cache")
    _, after = names["train"](table.folder, steps=60, cache=tmp_path / "cache")
    assert after < before / 2
    named = set(re.findall(r"`(?:batch\.)?(\w+)`", PAGE.read_text(encoding="utf-8")))
    assert {field.name for field in fields(MotionBatch)} <= named
