"""``scenes.parquet``: the boxes around people, a file that only some tables have."""

from __future__ import annotations

import json

import pytest

from prbench.errors import TableError
from prbench.sequences import SequenceTable
from prbench.sequences.folds import write_fold
from tests.fakes import fake_box, fake_dataset

BOXES = (fake_box("rec000", entered=None), fake_box("rec001", entered=0.3))


@pytest.fixture
def table(tmp_path):
    return fake_dataset(tmp_path / "table", 24, boxes=BOXES)


def test_boxes_come_back_as_they_were_written(table):
    rows = table.scenes().to_pylist()
    assert [row["recording_id"] for row in rows] == ["rec000", "rec001"]
    assert rows[0]["half_extents"] == [2.0, 0.45, 2.0]
    assert [row["entered"] for row in rows] == [None, 0.3]
    described = json.loads((table.folder / "croissant.json").read_text())
    assert {record["name"] for record in described["recordSet"]} >= {"scenes"}


def test_a_table_without_boxes_has_no_such_file_and_the_same_digests(table, tmp_path):
    plain = fake_dataset(tmp_path / "plain", 24)
    assert not plain.has_scenes
    assert plain.scenes().num_rows == 0
    assert not (plain.folder / "scenes.parquet").exists()
    assert (plain.identity, plain.content) == (table.identity, table.content)


def test_an_edited_and_a_missing_file_are_noticed(table, tmp_path):
    other = fake_dataset(tmp_path / "other", 24, boxes=BOXES[:1])
    (table.folder / "scenes.parquet").write_bytes((other.folder / "scenes.parquet").read_bytes())
    with pytest.raises(TableError, match=r"scenes\.parquet: expected the file that dataset\.json describes"):
        SequenceTable.open(table.folder)
    (table.folder / "scenes.parquet").unlink()
    with pytest.raises(TableError, match=r"expected scenes\.parquet"):
        SequenceTable.open(table.folder).scenes()


def test_folds_keep_the_boxes(table, tmp_path):
    write_fold(table, tmp_path / "fold", fold=1, folds=2)
    assert SequenceTable.open(tmp_path / "fold").scenes().equals(table.scenes())
