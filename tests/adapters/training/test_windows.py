"""Windows as training data: which are shown, where they begin, in which frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import TableError, UsageError
from prbench_adapters.training.batches import WindowChoice, WindowsDataset
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    broken = walking("b", 200, split="train", number=1)
    broken.joints_valid[100] = False
    blind = walking("c", 120, split="train", number=2, gaze=False)
    published = [replace(walking(f"p{n}", 80, split="test", number=3), published_split="train") for n in range(30)]
    folder = tmp_path_factory.mktemp("windows")
    write(folder, walking("a", 121, split="train"), broken, blind, walking("v", 80, split="validation"), *published)
    return WindowsTable.open(folder)


def test_every_item_stands_for_a_stretch_of_starts_with_bodies_and_gaze(table):
    data = WindowsDataset([table])
    # Run a: starts 0 … 46 in four stretches; b: 0 … 25 and 101 … 125, in two each; c has no gaze.
    assert len(data) == 4 + 2 + 3
    assert data.lengths.tolist() == [75] * 9
    for index in range(len(data)):
        for epoch in range(3):
            assert data[index, epoch].joints.shape == (75, 22, 3)


def test_starts_depend_on_epoch_and_index_alone(table):
    first = WindowsDataset([table])
    second = WindowsDataset([table])
    shown = [first[2, epoch].joints[0] for epoch in range(8)]
    assert (second[2, 5].joints[0] == shown[5]).all()
    assert len({joints.tobytes() for joints in shown}) > 1
    assert (first[2].joints == first[2, 0].joints).all()


def test_a_batch_stands_in_the_frame_of_its_last_observed_pose(table):
    data = WindowsDataset([table])
    batch = data.collate([data[index] for index in range(4)])
    assert batch.motion.shape == (4, 75, 23, 3)
    assert batch.motion[:, 14, 0, [0, 2]].abs().max() < 1e-6
    room = WindowsDataset([table], choice=WindowChoice(frame="room"))
    item = room[1]
    assert np.allclose(room.collate([item]).motion[0, :, :22], item.joints)


@pytest.mark.parametrize(("condition", "nodes"), [("pose", 22), ("pose+head", 23), ("pose+gaze", 23)])
def test_conditions_see_the_same_windows(table, condition, nodes):
    data = WindowsDataset([table], choice=WindowChoice(condition=Condition(condition)))
    assert data.collate([data[0]]).motion.shape[2] == nodes
    assert len(data) == 9


def test_a_tenth_of_the_published_segments_validates(table):
    choice = WindowChoice(split="published")
    parts = [WindowsDataset([table], split=split, choice=choice) for split in ("train", "validation")]
    assert sum(map(len, parts)) == len(WindowsDataset([table], split="train+validation", choice=choice)) == 30
    assert 0 < len(parts[1]) < 10


def test_people_can_be_left_out(table):
    data = WindowsDataset([table], choice=WindowChoice(left_out=("P1",)))
    assert len(data) == 4
    with pytest.raises(TableError, match="expected windows of split 'train'"):
        WindowsDataset([table], choice=WindowChoice(left_out=("P0", "P1")))


def test_validation_is_spread_over_the_table(table):
    data = WindowsDataset([table])
    assert data.spread(3) == (0, 3, 6)
    assert data.spread(100) == tuple(range(9))


def test_the_same_table_twice_and_tables_without_gaze_are_refused(table, tmp_path):
    with pytest.raises(UsageError, match="given twice"):
        WindowsDataset([table, table])
    write(tmp_path / "blind", walking("x", 120, split="train", gaze=False))
    with pytest.raises(UsageError, match=r"expected recorded gaze.*model\.windows\.condition=pose\+head"):
        WindowsDataset([tmp_path / "blind"])
