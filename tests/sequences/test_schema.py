"""Rows are read a group at a time, and of a file only the groups that may hold what is wanted."""

from __future__ import annotations

import tracemalloc
import weakref
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import TableError
from prbench.files.arrays import open_parquet
from prbench.sequences import SequenceTable, schema
from prbench.sequences.schema import groups_that_may_hold, identity_of_rows, require_distinct_rows
from tests.fakes import fake_dataset


def ids_file(path: Path, *, groups: int, statistics: bool = True) -> Path:
    names = [f"d/r{number:05d}/o/pick/1/fake" for number in range(10 * groups)]
    splits = ["test" if number < 5 * groups else "train" for number in range(10 * groups)]
    columns = pa.table({"sequence_id": names, "split": splits})
    pq.write_table(columns, path, row_group_size=10, write_statistics=statistics)
    return path


def test_the_footer_names_the_groups_that_may_hold_an_id(tmp_path):
    metadata = open_parquet(ids_file(tmp_path / "a.parquet", groups=6)).metadata
    assert groups_that_may_hold(metadata, {"sequence_id": ["d/r00023/o/pick/1/fake"]}) == [2]
    assert groups_that_may_hold(
        metadata, {"sequence_id": ["a", "d/r00000/o/pick/1/fake", "d/r00059/o/pick/1/fake"]}
    ) == [0, 5]
    assert groups_that_may_hold(metadata, {"sequence_id": ["z"]}) == []
    assert groups_that_may_hold(metadata, {"split": ["test"]}) == [0, 1, 2]
    assert groups_that_may_hold(metadata, {}) == list(range(6))


def test_a_footer_that_was_looked_at_is_freed(tmp_path):
    metadata = open_parquet(ids_file(tmp_path / "a.parquet", groups=3)).metadata
    groups_that_may_hold(metadata, {"sequence_id": ["z"]})
    freed = weakref.ref(metadata)
    del metadata
    assert freed() is None


def test_without_statistics_every_group_may_hold_it(tmp_path):
    metadata = open_parquet(ids_file(tmp_path / "a.parquet", groups=3, statistics=False)).metadata
    assert groups_that_may_hold(metadata, {"sequence_id": ["z"]}) == [0, 1, 2]


def test_one_sequence_is_read_without_the_groups_of_the_others(tmp_path, monkeypatch):
    table = fake_dataset(tmp_path / "table", 700, recordings=40)
    wanted = table.scalars(columns=["sequence_id"])["sequence_id"][600].as_py()
    read: list[list[int]] = []
    chosen = schema.groups_that_may_hold

    def noted(*arguments):
        read.append(chosen(*arguments))
        return read[-1]

    monkeypatch.setattr(schema, "groups_that_may_hold", noted)
    (found,) = table.chunks(ids=frozenset({wanted}))
    assert found.sequence_ids == [wanted]
    assert read == [[2]]


@pytest.mark.parametrize("order", [("a", "b", "c"), ("c", "a", "b")])
def test_the_identity_does_not_depend_on_the_order_of_rows(order):
    columns = {"sequence_id": list(order), "split": ["test"] * 3, "action": ["pick"] * 3, "n_frames": [7, 7, 7]}
    expected = identity_of_rows(pa.table(columns | {"sequence_id": ["a", "b", "c"]}), protocol_version=2)
    assert identity_of_rows(pa.table(columns), protocol_version=2) == expected


@pytest.mark.parametrize("names", [["a", "b", "b"], ["b", "a", "b"]])
def test_a_repeated_id_is_named_in_sorted_and_unsorted_rows(tmp_path, names):
    pq.write_table(pa.table({"sequence_id": names}), tmp_path / "a.parquet")
    with pytest.raises(TableError, match="found 'b' twice"):
        require_distinct_rows([tmp_path / "a.parquet"], "sequence_id", "here")
    pq.write_table(pa.table({"sequence_id": ["b", "a"]}), tmp_path / "a.parquet")
    require_distinct_rows([tmp_path / "a.parquet"], "sequence_id", "here")


def test_four_times_the_sequences_are_opened_in_about_the_same_memory(tmp_path):
    peaks = []
    for count in (250, 1000):
        folder = fake_dataset(tmp_path / str(count), count, recordings=40).folder
        tracemalloc.start()
        table = SequenceTable.open(folder)
        for _ in table.chunks(columns=["joints"]):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 2 * peaks[0]
