"""Tables of an older schema version open, with the columns that came later."""

from __future__ import annotations

import hashlib
import re

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import TableError
from prbench.sequences import SequenceTable
from prbench.sequences.schema import UnverifiedTableWarning, identity_of_rows
from tests.fakes import fake_dataset

LATER = {
    "events": ["left_wrist", "right_wrist", "published_priming", "published_prime_time", "hand_source"],
    "recordings": ["excluded_by_dataset", "not_published"],
}


def _as_version(table: SequenceTable, name: str, version: str, without: list[str]) -> None:
    path = table.folder / f"{name}.parquet"
    data = pq.read_table(path).drop_columns(without)
    pq.write_table(data.replace_schema_metadata({**data.schema.metadata, b"prbench_schema_version": version}), path)


def test_a_table_of_version_1_opens_with_nulls_and_zeros(tmp_path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    events, recordings, identity = table.events(), table.recordings(), table.identity
    for name in ("sequences", "events", "recordings"):
        _as_version(table, name, "1", LATER.get(name, []))
    info = table.folder / "dataset.json"
    info.write_bytes(re.sub(rb'"file_digests": \{.*?\}', b'"file_digests": {}', info.read_bytes(), flags=re.DOTALL))
    with pytest.warns(UnverifiedTableWarning, match="without digests of events and recordings"):
        old = SequenceTable.open(table.folder)
    for name in LATER["events"]:
        assert old.events()[name].null_count == events.num_rows
    for name in LATER["recordings"]:
        assert old.recordings()[name].to_pylist() == [0] * recordings.num_rows
    assert old.events().select(["event_id", "outcome"]).equals(events.select(["event_id", "outcome"]))
    assert old.identity == identity, "the sequences are what they were"


def test_a_table_of_version_2_opens_without_what_told_the_hand(tmp_path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    _as_version(table, "events", "2", ["hand_source"])
    assert table.events()["hand_source"].null_count == 6


def test_a_table_of_version_3_must_tell_it(tmp_path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    _as_version(table, "events", "3", ["hand_source"])
    with pytest.raises(TableError, match="expected a column 'hand_source'"):
        table.events()


def test_a_table_of_version_2_must_hold_them(tmp_path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    _as_version(table, "events", "2", ["left_wrist"])
    with pytest.raises(TableError, match="expected a column 'left_wrist'"):
        table.events()


def test_the_identity_of_sequences_outlives_columns_of_other_tables() -> None:
    of_version_1 = hashlib.sha256(b"prbench schema 1 protocol 1\nd/r/o/pick/1/egoallo\ttest\tpick\t7\n").hexdigest()
    rows = pa.table({"sequence_id": ["d/r/o/pick/1/egoallo"], "split": ["test"], "action": ["pick"], "n_frames": [7]})
    assert identity_of_rows(rows, protocol_version=1) == of_version_1
