"""Batches as tensors, their order, and windows of motion prediction as training data."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from itertools import chain, islice

import numpy as np
import pytest
import torch

from prbench.errors import TableError, UsageError
from prbench_adapters.training import LengthBatches, SequenceDataset, collate
from prbench_adapters.training.batches import WindowChoice, WindowsDataset, load_batches
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.adapters.training.tables import corpus_table, sequence_table
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    tables = [sequence_table(folder / "t"), corpus_table(folder / "c")]
    return SequenceDataset(tables, max_frames=80, crop="random", cache=folder / "cache")


def test_a_batch_holds_its_items_and_zeros(data):
    items = [data[index] for index in (0, 3, 7)]
    batch = collate(items)
    assert batch.features.shape == (3, max(item.n_frames for item in items), 263)
    for row, item in enumerate(items):
        n = item.n_frames
        np.testing.assert_array_equal(batch.features[row, :n], item.features)
        np.testing.assert_array_equal(batch.joints[row, :n], item.joints)
        assert not batch.features[row, n:].any()
        assert not batch.joints[row, n:].any()
        assert batch.padding[row].tolist() == [frame >= n for frame in range(batch.padding.shape[1])]
        for name in ("initial_joints", "previous_joints", "goal_joints", "goal_location"):
            np.testing.assert_array_equal(getattr(batch, name)[row], getattr(item, name))
    assert batch.n_frames.tolist() == [item.n_frames for item in items]
    assert (batch.text, batch.fps) == (tuple(item.text for item in items), 20.0)


def test_a_batch_goes_to_a_device_whole(data):
    moved = collate([data[0], data[1]]).to("meta")
    tensors = [value for field in fields(moved) if isinstance(value := getattr(moved, field.name), torch.Tensor)]
    assert len(tensors) == 8
    assert {tensor.device.type for tensor in tensors} == {"meta"}


def test_items_of_two_frame_rates_and_fewer_workers_than_none_are_refused(data):
    with pytest.raises(ValueError, match="one frame rate"):
        collate([data[0], replace(data[1], fps=30.0)])
    with pytest.raises(UsageError, match="workers is -1"):
        load_batches(data, LengthBatches(data, 4), workers=-1)


def test_loading_data_needs_no_lightning():
    code = "import sys, prbench_adapters.training.batches; sys.exit(any('lightning' in name for name in sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True)


class Lengths(SequenceDataset):
    """Items of which nothing but the length is known."""

    lengths = np.empty(0)

    def __init__(self, lengths):
        self.lengths = lengths


def planned(lengths, *arguments, n=40, **more):
    """The first batches for items of these lengths."""
    return list(islice(LengthBatches(Lengths(np.asarray(lengths)), *arguments, **more), n))


@pytest.fixture
def lengths():
    return np.random.default_rng(3).integers(40, 241, size=1000)


def test_a_run_goes_on_at_any_step(lengths):
    whole = planned(lengths, 16, 5, n=150)
    for start in (1, 61, 62, 63, 125, 149):
        assert planned(lengths, 16, 5, n=1, start_step=start) == whole[start : start + 1]


def test_two_processes_see_what_one_with_twice_the_batch_sees_and_share_no_item(lengths):
    alone = planned(lengths, 16, 5)
    for batch, one, other in zip(alone, *(planned(lengths, 8, 5, rank, 2) for rank in (0, 1)), strict=True):
        assert set(batch) == set(one + other)
        assert len(one) == len(other) == 8
        assert not set(one) & set(other)


def test_an_epoch_shows_no_item_twice_and_the_next_one_another_order(lengths):
    an_epoch = len(lengths) // 16
    batches = planned(lengths, 16, 5, n=2 * an_epoch)
    first, second = (list(chain(*part)) for part in (batches[:an_epoch], batches[an_epoch:]))
    assert len({index for index, _ in first}) == len(first) == an_epoch * 16
    assert {epoch for _, epoch in first} == {0}
    assert {epoch for _, epoch in second} == {1}
    assert [index for index, _ in first] != [index for index, _ in second]


def test_little_padding_is_trained_and_long_and_short_batches_come_in_any_order(lengths):
    batches = [lengths[[index for index, _ in batch]] for batch in planned(lengths, 16, 5)]
    padded = sum(len(batch) * batch.max() for batch in batches)
    assert 1 - sum(batch.sum() for batch in batches) / padded < 0.06  # 30 % in random order
    assert 10 < (np.diff([batch.max() for batch in batches]) > 0).sum() < 30


def test_a_small_set_is_shown_several_times_with_new_draws():
    batches = planned([50, 60, 70], 8, 5, n=3)
    assert all(len(batch) == len(set(batch)) == 8 for batch in batches)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [((0,), "batch_size 0"), ((8, 0, 2, 2), "rank 2 of 2"), ((8, 0, 0, 1, -1), "start_step -1")],
)
def test_numbers_out_of_range_are_refused(lengths, arguments, message):
    with pytest.raises(UsageError, match=message):
        planned(lengths, *arguments)


@pytest.fixture(scope="module")
def windows(tmp_path_factory):
    broken = walking("b", 200, split="train", number=1)
    broken.joints_valid[100] = False
    blind = walking("c", 120, split="train", number=2, gaze=False)
    published = [replace(walking(f"p{n}", 80, split="test", number=3), published_split="train") for n in range(30)]
    folder = tmp_path_factory.mktemp("windows")
    write(folder, walking("a", 121, split="train"), broken, blind, walking("v", 80, split="validation"), *published)
    return WindowsTable.open(folder)


def test_every_item_stands_for_a_stretch_of_starts_with_bodies_and_gaze(windows):
    data = WindowsDataset([windows])
    # Run a: starts 0 … 46 in four stretches; b: 0 … 25 and 101 … 125, in two each; c has no gaze.
    assert len(data) == 4 + 2 + 3
    assert data.lengths.tolist() == [75] * 9
    assert data.spread(3) == (0, 3, 6)  # of validation, over the table
    assert data.spread(100) == tuple(range(9))
    for index in range(len(data)):
        for epoch in range(3):
            assert data[index, epoch].joints.shape == (75, 22, 3)


def test_starts_depend_on_epoch_and_index_alone(windows):
    first = WindowsDataset([windows])
    second = WindowsDataset([windows])
    shown = [first[2, epoch].joints[0] for epoch in range(8)]
    assert (second[2, 5].joints[0] == shown[5]).all()
    assert len({joints.tobytes() for joints in shown}) > 1
    assert (first[2].joints == first[2, 0].joints).all()


def test_a_batch_stands_in_the_frame_of_its_last_observed_pose(windows):
    data = WindowsDataset([windows])
    batch = data.collate([data[index] for index in range(4)])
    assert batch.motion.shape == (4, 75, 23, 3)
    assert batch.motion[:, 14, 0, [0, 2]].abs().max() < 1e-6
    room = WindowsDataset([windows], choice=WindowChoice(frame="room"))
    assert np.allclose(room.collate([room[1]]).motion[0, :, :22], room[1].joints)
    for condition, nodes in (("pose", 22), ("pose+head", 23), ("pose+gaze", 23)):
        data = WindowsDataset([windows], choice=WindowChoice(condition=Condition(condition)))
        assert data.collate([data[0]]).motion.shape[2] == nodes
        assert len(data) == 9


def test_a_tenth_of_the_published_segments_validates(windows):
    choice = WindowChoice(split="published")
    parts = [WindowsDataset([windows], split=split, choice=choice) for split in ("train", "validation")]
    assert sum(map(len, parts)) == len(WindowsDataset([windows], split="train+validation", choice=choice)) == 30
    assert 0 < len(parts[1]) < 10


def test_people_can_be_left_out(windows):
    data = WindowsDataset([windows], choice=WindowChoice(left_out=("P1",)))
    assert len(data) == 4
    with pytest.raises(TableError, match="expected windows of split 'train'"):
        WindowsDataset([windows], choice=WindowChoice(left_out=("P0", "P1")))


def test_the_same_table_twice_and_tables_without_gaze_are_refused(windows, tmp_path):
    with pytest.raises(UsageError, match="given twice"):
        WindowsDataset([windows, windows])
    write(tmp_path / "blind", walking("x", 120, split="train", gaze=False))
    with pytest.raises(UsageError, match=r"expected recorded gaze.*model\.windows\.condition=pose\+head"):
        WindowsDataset([tmp_path / "blind"])
