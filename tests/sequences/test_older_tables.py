"""Tables of another schema version are refused; the identity of sequences does not depend on other tables."""

from __future__ import annotations

import hashlib

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import TableError
from prbench.sequences.schema import identity_of_rows
from tests.fakes import fake_dataset


@pytest.mark.parametrize("version", ["1", "2", "4"])
def test_a_table_of_another_version_is_refused(tmp_path, version) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    path = table.folder / "events.parquet"
    data = pq.read_table(path)
    pq.write_table(data.replace_schema_metadata({**data.schema.metadata, b"prbench_schema_version": version}), path)
    with pytest.raises(TableError, match=f"expected schema version 3, found {version}"):
        table.events()


def test_the_identity_of_sequences_outlives_columns_of_other_tables() -> None:
    of_version_1 = hashlib.sha256(b"prbench schema 1 protocol 1\nd/r/o/pick/1/egoallo\ttest\tpick\t7\n").hexdigest()
    rows = pa.table({"sequence_id": ["d/r/o/pick/1/egoallo"], "split": ["test"], "action": ["pick"], "n_frames": [7]})
    assert identity_of_rows(rows, protocol_version=1) == of_version_1
