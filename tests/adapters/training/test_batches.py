"""Batches as tensors: padding, workers, the clock."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from itertools import chain, islice

import numpy as np
import pytest
import torch

from prbench.errors import UsageError
from prbench_adapters.training import LengthBatches, MotionBatch, SequenceDataset, collate
from prbench_adapters.training.batches import load_batches
from tests.adapters.training.tables import corpus_table, sequence_table


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


def test_items_of_two_frame_rates_do_not_mix(data):
    with pytest.raises(ValueError, match="one frame rate"):
        collate([data[0], replace(data[1], fps=30.0)])


def contents(batches: list[MotionBatch]) -> list:
    return [
        (b.features.numpy().tobytes(), b.joints.numpy().tobytes(), b.n_frames.tolist(), b.text, b.sequence_id)
        for b in batches
    ]


def test_any_number_of_workers_gives_the_same_bytes(data):
    plan = LengthBatches(data, 4, seed=1, start_step=2)
    alone = contents(list(islice(load_batches(data, plan), 7)))
    assert len({ids for *_, ids in alone}) == 7
    assert contents(list(islice(load_batches(data, plan, workers=2), 7))) == alone


def test_fewer_workers_than_none_are_refused(data):
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


def test_processes_share_a_step_without_a_common_item(lengths):
    first, second = (planned(lengths, 8, 5, rank, 2, n=30) for rank in (0, 1))
    seen = [set(chain(*batches)) for batches in (first, second)]
    assert not seen[0] & seen[1]
    assert all(len(one) == len(other) for one, other in zip(first, second))


def test_two_processes_see_what_one_with_twice_the_batch_sees(lengths):
    alone = planned(lengths, 16, 5)
    halves = (planned(lengths, 8, 5, rank, 2) for rank in (0, 1))
    assert [set(batch) for batch in alone] == [set(one + other) for one, other in zip(*halves)]


def test_an_epoch_shows_no_item_twice_and_the_next_one_another_order(lengths):
    an_epoch = len(lengths) // 16
    batches = planned(lengths, 16, 5, n=2 * an_epoch)
    first, second = (list(chain(*part)) for part in (batches[:an_epoch], batches[an_epoch:]))
    assert len({index for index, _ in first}) == len(first) == an_epoch * 16
    assert {epoch for _, epoch in first} == {0}
    assert {epoch for _, epoch in second} == {1}
    assert [index for index, _ in first] != [index for index, _ in second]


def test_another_seed_gives_another_order(lengths):
    assert planned(lengths, 16, 5) != planned(lengths, 16, 6)


def test_little_padding_is_trained(lengths):
    batches = [lengths[[index for index, _ in batch]] for batch in planned(lengths, 16, 5)]
    padded = sum(len(batch) * batch.max() for batch in batches)
    assert 1 - sum(batch.sum() for batch in batches) / padded < 0.06  # 30 % in random order


def test_batches_of_long_and_of_short_items_come_in_any_order(lengths):
    longest = [lengths[[index for index, _ in batch]].max() for batch in planned(lengths, 16, 5)]
    steps = np.sign(np.diff(longest))
    assert 10 < (steps > 0).sum() < 30


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
