"""Which sequences are run, in which batches."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from prbench.errors import TableError, UsageError
from prbench.harness import planning
from prbench.harness.planning import plan_batches, plan_digest, select
from tests.fakes import fake_dataset


def test_limit_takes_the_smallest_hashes_in_table_order(table):
    everything = select(table, split="test", limit=None).sequence_ids
    chosen = select(table, split="test", limit=4).sequence_ids
    smallest = sorted(everything, key=lambda name: hashlib.sha256(name.encode()).hexdigest())[:4]
    assert chosen == tuple(sorted(smallest))


def test_a_limit_above_the_split_takes_all(table):
    assert (
        select(table, split="test", limit=10_000).sequence_ids == select(table, split="test", limit=None).sequence_ids
    )


def test_an_unknown_split_is_named_with_the_known_ones(table):
    with pytest.raises(UsageError, match=r"unknown split 'tset'; the splits are: train, validation, test"):
        select(table, split="tset", limit=None)


def test_an_empty_split_says_what_the_table_has(tmp_path):
    table = fake_dataset(tmp_path / "d", 3, recordings=12)  # recordings 0, 1, 2: train, test, train
    with pytest.raises(TableError, match=r"split 'validation', found none \(train 2, validation 0, test 1\)"):
        select(table, split="validation", limit=None)


def test_every_sequence_is_in_one_batch_and_batches_hold_similar_lengths():
    n_frames = np.random.default_rng(0).integers(41, 200, size=3000)
    plan = plan_batches(n_frames, 32)
    assert sorted(np.concatenate(plan)) == list(range(3000))
    assert max(map(len, plan)) == 32
    padded = sum(len(rows) * n_frames[rows].max() for rows in plan)
    assert padded < 1.05 * n_frames.sum()


def test_no_batch_crosses_a_window(monkeypatch):
    monkeypatch.setattr(planning, "WINDOW", 10)
    plan = plan_batches(np.arange(25)[::-1].copy(), 4)
    assert [len(rows) for rows in plan] == [4, 4, 2, 4, 4, 2, 4, 1]
    assert all(len({row // 10 for row in rows}) == 1 for rows in plan)


def test_sequences_of_equal_length_keep_the_order_of_the_table():
    n_frames = np.tile([60, 50], 400)
    first_window = np.concatenate([rows for rows in plan_batches(n_frames, 7) if rows.max() < planning.WINDOW])
    assert list(first_window) == [*range(1, 800, 2), *range(0, 800, 2)]


def test_the_plan_digest_sees_order_and_borders():
    ids = ("a", "b", "c", "d")
    one = plan_digest(ids, [np.array([0, 1]), np.array([2, 3])])
    assert one != plan_digest(ids, [np.array([0]), np.array([1, 2, 3])])
    assert one != plan_digest(ids, [np.array([1, 0]), np.array([2, 3])])


@pytest.mark.parametrize("window", [1, 4, 7, 100])
def test_windows_stream_the_selection_in_order(table, monkeypatch, window):
    monkeypatch.setattr(planning, "WINDOW", window)
    selection = select(table, split="test", limit=9)
    names, total = [], 0
    for place, chunk in selection.windows(["joints"]):
        assert (place.start, place.stop) == (total, total + len(chunk))
        assert len(chunk) <= window
        assert len(chunk.joints) == chunk.n_frames.sum()
        total += len(chunk)
        names += chunk.sequence_ids
    assert tuple(names) == selection.sequence_ids
