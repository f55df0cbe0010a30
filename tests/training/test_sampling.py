"""Which items come when: a pure function of seed and step, shared between processes, with little padding."""

from __future__ import annotations

from itertools import chain, islice

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.training.dataset import SequenceDataset
from prbench.training.sampling import LengthBatches


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


@pytest.mark.parametrize("unit", ["sequences", "frames"])
def test_a_run_goes_on_at_any_step(lengths, unit):
    size = {"sequences": 16, "frames": 16 * 241}[unit]
    whole = planned(lengths, size, 5, unit=unit, n=150)
    for start in (1, 61, 62, 63, 125, 149):
        assert planned(lengths, size, 5, unit=unit, n=1, start_step=start) == whole[start : start + 1]


@pytest.mark.parametrize("unit", ["sequences", "frames"])
def test_processes_share_a_step_without_a_common_item(lengths, unit):
    size = {"sequences": 8, "frames": 8 * 241}[unit]
    first, second = (planned(lengths, size, 5, rank, 2, unit=unit, n=30) for rank in (0, 1))
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


@pytest.mark.parametrize("unit", ["sequences", "frames"])
def test_little_padding_is_trained(lengths, unit):
    size = {"sequences": 16, "frames": 16 * 241}[unit]
    batches = [lengths[[index for index, _ in batch]] for batch in planned(lengths, size, 5, unit=unit)]
    padded = sum(len(batch) * batch.max() for batch in batches)
    assert 1 - sum(batch.sum() for batch in batches) / padded < 0.06  # 30 % in random order


def test_batches_of_long_and_of_short_items_come_in_any_order(lengths):
    longest = [lengths[[index for index, _ in batch]].max() for batch in planned(lengths, 16, 5)]
    steps = np.sign(np.diff(longest))
    assert 10 < (steps > 0).sum() < 30


def test_batches_by_frames_never_hold_more(lengths):
    for batch in planned(lengths, 2000, 5, unit="frames", n=200):
        chosen = lengths[[index for index, _ in batch]]
        assert len(chosen) * chosen.max() <= 2000


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


def test_a_batch_of_frames_that_holds_no_item_is_refused(lengths):
    with pytest.raises(UsageError, match="longest item"):
        planned(lengths, 200, unit="frames")
