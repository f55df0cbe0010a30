"""What a Parquet file declares is held against what a table can hold before a row is unpacked."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import PredictionsError, RunError, TableError
from prbench.files import arrays
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.scores import read_scores
from prbench.sequences.schema import open_parquet

ROWS = 10**6


@pytest.fixture(scope="module")
def many_rows(tmp_path_factory):
    """Nine million rows of nothing in some kilobytes."""
    path = tmp_path_factory.mktemp("bomb") / "part-0.parquet"
    rows = pa.table({"sequence_id": pa.nulls(ROWS, pa.string()), "joints": pa.nulls(ROWS, pa.list_(pa.float32()))})
    with pq.ParquetWriter(path, rows.schema) as writer:
        for _ in range(9):
            writer.write_table(rows)
    assert path.stat().st_size < 100_000
    return path


@pytest.mark.parametrize(
    ("read", "error"),
    [
        (open_parquet, TableError),
        (Predictions.open, PredictionsError),
        (read_scores, RunError),
    ],
    ids=["table", "predictions", "scores"],
)
def test_billions_of_rows_in_a_small_file_are_refused(many_rows, read, error):
    with pytest.raises(error, match=r"part-0\.parquet.*9,000,000 rows declared, expected at most 8,388,608"):
        read(many_rows)


def test_long_lists_are_held_against_the_bytes_that_are_stored(tmp_path, monkeypatch):
    monkeypatch.setattr(arrays, "MOST_VALUES", 1000)
    for name, values in {"bomb": np.zeros(10**5), "honest": np.random.default_rng(0).random(10**5)}.items():
        rows = pa.table({"joints": pa.array([values], pa.list_(pa.float64()))})
        pq.write_table(rows, tmp_path / f"{name}.parquet")
    assert arrays.read_parquet(tmp_path / "honest.parquet").num_rows == 1
    with pytest.raises(pa.ArrowInvalid, match=r"100,000 values of 'joints\.list\.element' declared in row group 0"):
        arrays.read_parquet(tmp_path / "bomb.parquet")


def test_a_column_that_is_not_there_is_named(tmp_path):
    pq.write_table(pa.table({"a": [1]}), tmp_path / "a.parquet")
    with pytest.raises(pa.ArrowInvalid, match="no column 'b'"):
        arrays.read_parquet(tmp_path / "a.parquet", ["a", "b"])
