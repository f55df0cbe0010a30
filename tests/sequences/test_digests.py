"""Edits of a built table or corpus are noticed by whoever opens it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.errors import TableError
from prbench.sequences import CorpusTable, SequenceTable
from tests.adapters.training.tables import corpus_table
from tests.fakes import fake_dataset


def edit(path: Path, column: str) -> None:
    """Change the first value of a column, whatever it is of."""
    rows = pq.read_table(path)
    index = rows.schema.get_field_index(column)
    values = rows[column].to_pylist()
    values[0] = f"{values[0]}x" if isinstance(values[0], str) else values[0] + 1.0
    pq.write_table(
        rows.set_column(index, rows.schema.field(index), pa.array(values, rows.schema.field(index).type)), path
    )


EDITS = [("sequences", "prime_time"), ("sequences", "text"), ("events", "event_time"), ("recordings", "duration")]


@pytest.mark.parametrize(("name", "column"), EDITS)
def test_an_edited_file_is_named_when_the_table_is_opened(tmp_path: Path, name: str, column: str) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    edit(table.folder / f"{name}.parquet", column)
    with pytest.raises(TableError, match=rf"{name}\.parquet: .* changed after the build"):
        SequenceTable.open(table.folder)


def test_every_command_that_opens_a_table_refuses_an_edited_one(tmp_path: Path, capsys) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    edit(table.folder / "events.parquet", "event_time")
    data = str(table.folder)
    np.savez(tmp_path / "p.npz", joints=np.zeros((1, 40, 22, 3), dtype=np.float32))
    event = table.scalars()["sequence_id"][0].as_py()
    for command in (
        ["inspect", data],
        ["explain", event, "--data", data],
        ["diff", data, data],
        ["view", "--data", data, "--out", str(tmp_path / "x.png")],
        ["run", "--method", "static", "--condition", "none", "--data", data, "--out", str(tmp_path / "run")],
        ["export-conditions", "--condition", "none", "--data", data, "--out", str(tmp_path / "c.npz")],
        ["score", str(tmp_path / "p.npz"), "--data", data],
        ["doctor", str(tmp_path / "p.npz"), "--data", data],
        ["train", "--method", "mdm", "--config", "smoke", "--data", data, "--out", str(tmp_path / "trained")],
        ["export-release", data, "--out", str(tmp_path / "released")],
        ["datasets", "--cite", data],
    ):
        assert main(command) == TableError.exit_code, command
        assert "events.parquet: expected the file that dataset.json describes" in capsys.readouterr().err, command


@pytest.mark.parametrize(("name", "column"), [("clips", "fps"), ("recordings", "duration")])
def test_an_edited_corpus_is_refused(tmp_path: Path, name: str, column: str) -> None:
    corpus = corpus_table(tmp_path / "c")
    edit(corpus.folder / f"{name}.parquet", column)
    with pytest.raises(TableError, match=rf"{name}\.parquet: .* changed after the build"):
        CorpusTable.open(corpus.folder)


def test_a_main_table_written_anew_with_equal_values_is_the_same(tmp_path: Path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    path = table.folder / "sequences.parquet"
    pq.write_table(pq.read_table(path), path, compression="snappy")
    assert SequenceTable.open(table.folder).content == table.content


def test_a_table_without_digests_of_its_files_is_refused(tmp_path: Path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    described = json.loads((table.folder / "dataset.json").read_text())
    del described["file_digests"]
    (table.folder / "dataset.json").write_text(json.dumps(described))
    with pytest.raises(TableError, match=r"events\.parquet: expected the file that dataset\.json describes"):
        SequenceTable.open(table.folder)
    edit(table.folder / "sequences.parquet", "prime_time")
    with pytest.raises(TableError, match="changed after the build"):
        SequenceTable.open(table.folder)


def test_a_row_that_was_added_to_a_table_is_noticed(tmp_path: Path) -> None:
    table = fake_dataset(tmp_path / "d", 6)
    path = table.folder / "recordings.parquet"
    rows = pq.read_table(path)
    pq.write_table(pa.concat_tables([rows, rows.filter(pc.field("split") == "test")]), path)
    with pytest.raises(TableError, match=r"recordings\.parquet"):
        SequenceTable.open(table.folder)
