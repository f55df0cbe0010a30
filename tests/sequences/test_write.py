"""What is written: Croissant descriptions, and what may replace a table or corpus that stands already."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from prbench.errors import RecordingsWouldBeLost
from prbench.sequences import CorpusInfo, Recording, SequenceTable
from prbench.sequences.corpus import CorpusRecord, corpus_batch, write_corpus
from prbench.sequences.dataset_info import CORPUS_FILE, FILE_NAME
from prbench.sequences.parts import plain
from prbench.sequences.schema import EVENTS, RECORDINGS, SEQUENCES
from prbench.sequences.sequence import recording_batch, sequence_batch
from prbench.sequences.write import require_no_loss, write_croissant, write_table_in_parts
from tests.adapters.training.tables import corpus_table
from tests.curation.sources import folder_bytes
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
        told = [(field["description"].encode(), field["unitText"].encode()) for field in record_set["field"]]
        assert told == [(field.metadata[b"description"], field.metadata[b"unit"]) for field in schema]
    joints = next(field for field in document["recordSet"][0]["field"] if field["name"] == "joints")
    assert joints["arrayShape"] == "-1,66"
    assert joints["dataType"] == "sc:Float"
    fields = document["recordSet"][0]["field"]
    kinds = {field["name"]: (field.get("dataType"), field.get("arrayShape")) for field in fields}
    assert kinds["gaze_valid"] == ("sc:Boolean", "-1")
    assert [kinds[name] for name in ("n_frames", "split")] == [("sc:Integer", None), ("sc:Text", None)]
    for entry in document["distribution"]:
        content = (folder / entry["contentUrl"]).read_bytes()
        assert entry["sha256"] == hashlib.sha256(content).hexdigest()
        assert entry["contentSize"] == f"{len(content)} B"
        assert entry["@id"] == entry["name"] == entry["contentUrl"]
    assert {entry["@id"] for entry in document["distribution"]} >= {"sequences.parquet", "events.parquet"}
    assert [each["key"]["@id"] for each in document["recordSet"]] == [
        "sequences/sequence_id", "events/event_id", "recordings/recording_id",
    ]  # fmt: skip


def test_a_croissant_tells_what_the_dataset_says_of_itself_and_nothing_that_it_does_not(folder) -> None:
    info = msgspec.structs.replace(SequenceTable.open(folder).info, homepage="https://a.b", citation="@misc{c}")
    write_croissant(folder, info, {"sequences": SEQUENCES}, {"sequences": "One sequence."})
    document = json.loads((folder / "croissant.json").read_text())
    told = {name: document[name] for name in document if name not in ("@context", "distribution", "recordSet")}
    assert told == {
        "@type": "sc:Dataset", "conformsTo": "http://mlcommons.org/croissant/1.1",
        "name": "synthetic-adt-prime-and-reach",
        "description": f"{info.title}: {info.counts.sequences} prime-and-reach sequences built by prbench"
        f" {info.prbench_version}, protocol {info.protocol_version}. Identity digest {info.identity_digest}.",
        "version": f"{info.schema_version}.{info.protocol_version}.0", "license": info.licence,
        "conditionsOfAccess": f"redistribution: {info.redistribution}", "isLiveDataset": False,
        "url": "https://a.b", "citeAs": "@misc{c}",
    }  # fmt: skip
    bare = msgspec.structs.replace(info, homepage="", citation="")
    write_croissant(folder, bare, {"sequences": SEQUENCES}, {"sequences": "One sequence."})
    document = json.loads((folder / "croissant.json").read_text())
    assert not {"url", "citeAs"} & set(document)
    assert document["recordSet"][0]["description"] == "One sequence."


def holdings(**yields: int) -> list[pa.RecordBatch]:
    records = [
        Recording(name, "P0", "train", name, 60.0, {"sequence": number}, "read", "") for name, number in yields.items()
    ]
    failed = Recording("never", "P0", "train", "never", 0.0, {}, "failed", "b.csv: cut off")
    return [recording_batch(records), recording_batch([failed])]


def refused(folder: Path, new: list[pa.RecordBatch], *incomplete: str) -> str:
    with pytest.raises(RecordingsWouldBeLost) as error:
        require_no_loss(folder, FILE_NAME, new, outcome="sequence", what="sequences", incomplete=incomplete)
    return str(error.value)


def allow(folder: Path, new: list[pa.RecordBatch], *incomplete: str) -> None:
    require_no_loss(folder, FILE_NAME, new, outcome="sequence", what="sequences", incomplete=incomplete)


def test_fewer_sequences_of_whole_recordings_are_a_choice_of_options_and_no_loss(tmp_path) -> None:
    fake_dataset(tmp_path / "d", 4, recordings=2)
    allow(tmp_path / "d", holdings(rec000=1, rec001=1))
    allow(tmp_path / "d", holdings(rec000=1, rec001=0))
    assert "rec001 (0 of 2 sequences" in refused(tmp_path / "d", holdings(rec000=2, rec001=0), "rec001", "rec000")
    assert "the new one 2 with 0" in refused(tmp_path / "d", holdings(rec000=0, rec001=0))
    assert "rec000 (not found)" in refused(tmp_path / "d", holdings(rec001=9, rec009=9))


def test_where_nothing_stands_nothing_is_lost(tmp_path) -> None:
    allow(tmp_path / "nowhere", holdings())
    (tmp_path / "empty").mkdir()
    allow(tmp_path / "empty", holdings())


def test_a_corpus_is_no_more_replaced_by_less_than_a_table(tmp_path) -> None:
    folder = corpus_table(tmp_path / "c").folder
    info = CorpusInfo.read(folder)
    failed = CorpusRecord(
        recording_id="rec", participant_id="P0", split="train", split_group="rec", duration=0.0, outcomes={},
        clock_method="none", clock_quality=None, status="failed", message="no such file",
    )  # fmt: skip
    tables = {"clips": [], "annotations": [], "recordings": [corpus_batch("recordings", [failed])]}
    before = folder_bytes(folder)
    with pytest.raises(RecordingsWouldBeLost, match=r"rec \(failed: no such file\)"):
        write_corpus(folder, info, tables)
    assert folder_bytes(folder) == before
    write_corpus(folder, info, tables, replace=True)
    assert (folder / CORPUS_FILE).read_bytes() != before[CORPUS_FILE]


def test_receipts_hold_plain_numbers_whatever_a_reader_measured() -> None:
    record = Recording("a", "P0", "train", "a", 1.0, {"sequence": 1}, "read", "")
    found = plain({"record": replace(record, duration=np.float64(2.5)), "share": np.float32(0.5), "n": np.int64(3)})
    assert found == {"record": plain(replace(record, duration=2.5)), "share": 0.5, "n": 3}
    assert [type(found[name]) for name in ("share", "n")] == [float, int]
