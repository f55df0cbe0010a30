"""Batches as tensors: padding, workers, the clock."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import fields, replace
from itertools import islice

import numpy as np
import pytest
import torch

from prbench.errors import UsageError
from prbench.training import LengthBatches, MotionBatch, SequenceDataset, collate
from prbench.training.loading import WaitingClock, load_batches
from tests.training.tables import corpus_table, sequence_table


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


def test_the_clock_tells_waiting_from_work():
    def slow():
        for _ in range(3):
            time.sleep(0.03)
            yield None

    clock = WaitingClock()
    assert clock.fraction == 0.0
    for _ in clock.timed(slow()):
        time.sleep(0.01)
    assert clock.waited >= 0.09
    assert 0.5 < clock.fraction < 0.95


def test_loading_data_needs_no_lightning():
    code = "import sys, prbench.training.loading; sys.exit(any('lightning' in name for name in sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True)
