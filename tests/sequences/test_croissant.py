from __future__ import annotations

import json

import pytest

from prbench.sequences import SequenceTable
from prbench.sequences.schema import EVENTS, RECORDINGS, SEQUENCES
from prbench.sequences.sequence import sequence_batch
from prbench.sequences.write import write_croissant, write_table_in_parts
from tests.fakes import fake_dataset, fake_sequence


@pytest.fixture
def folder(tmp_path):
    fake_dataset(tmp_path / "table", n=5)
    return tmp_path / "table"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_official_checker_accepts_it_and_reads_the_rows_through_it(folder) -> None:
    mlcroissant = pytest.importorskip("mlcroissant", reason="needs mlcroissant: pip install 'prbench[test]'")
    dataset = mlcroissant.Dataset(folder / "croissant.json")
    assert not dataset.metadata.issues.errors
    expected = SequenceTable.open(folder).events()
    rows = list(dataset.records("events"))
    assert [row["events/event_id"].decode() for row in rows] == expected["event_id"].to_pylist()
    assert [row["events/event_time"] for row in rows] == expected["event_time"].to_pylist()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_official_checker_reads_the_rows_of_a_table_in_parts(folder) -> None:
    mlcroissant = pytest.importorskip("mlcroissant", reason="needs mlcroissant: pip install 'prbench[test]'")
    table = SequenceTable.open(folder)
    rows = [fake_sequence(i) for i in range(5)]
    batches = [sequence_batch([row]) for row in rows]
    write_table_in_parts(folder, "sequences", batches, SEQUENCES, protocol_version=1, largest_part=1)
    assert len(list((folder / "sequences").glob("part-*.parquet"))) > 1
    write_croissant(folder, table.info, {"sequences": SEQUENCES}, {"sequences": "One sequence."})
    dataset = mlcroissant.Dataset(folder / "croissant.json")
    assert not dataset.metadata.issues.errors
    read = {row["sequences/sequence_id"].decode(): row["sequences/extra"] for row in dataset.records("sequences")}
    note = {"sequences/extra/key": b"note", "sequences/extra/value": b"made up"}
    assert read == {row.sequence_id: [note] if row.extra else [] for row in rows}
    assert [note] in read.values()


def test_every_column_is_a_field_and_every_file_has_its_digest(folder) -> None:
    document = json.loads((folder / "croissant.json").read_text())
    for record_set, schema in zip(document["recordSet"], (SEQUENCES, EVENTS, RECORDINGS), strict=True):
        assert [field["name"] for field in record_set["field"]] == schema.names
    joints = next(field for field in document["recordSet"][0]["field"] if field["name"] == "joints")
    assert joints["arrayShape"] == "-1,66"
    assert joints["dataType"] == "sc:Float"
    assert {entry["@id"] for entry in document["distribution"]} >= {"sequences.parquet", "events.parquet"}
    assert all(len(entry["sha256"]) == 64 for entry in document["distribution"])
