"""A method learns from training rows, even if it forgets to ask for them."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.harness.methods import training_split as training_copy
from prbench.harness.methods.training_split import TrainingSplit, temporary_copy, write_training_copy
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.sequences import DatasetInfo, SequenceTable
from tests.fakes import fake_dataset
from tests.method_fixtures import adapter_source


def opened(folder: Path) -> TrainingSplit:
    return TrainingSplit(folder, DatasetInfo.read(folder))


CURIOUS = """
        def fit(self, train, *, validation, run):
            run.folder.mkdir(parents=True, exist_ok=True)
            seen = [name for chunk in train.chunks({split}) for name in chunk.sequence_ids]
            (run.folder / "seen").write_text("\\n".join(seen))
"""


def learns(split: str = "") -> str:
    return adapter_source().replace("    def load", f"{CURIOUS.format(split=split)}\n    def load")


def ids(table, split: str) -> list[str]:
    return table.scalars(split=split)["sequence_id"].to_pylist()


def test_all_rows_of_the_view_are_training_rows_and_its_digests_those_of_the_table(table):
    view = TrainingSplit.open(table.folder)
    assert view.scalars()["sequence_id"].to_pylist() == ids(table, "train")
    assert [name for chunk in view.chunks() for name in chunk.sequence_ids] == ids(table, "train")
    assert (view.identity, view.content) == (table.identity, table.content)


def test_events_and_recordings_of_the_view_are_those_of_training_rows(table):
    view = TrainingSplit.open(table.folder)
    assert set(view.recordings()["split"].to_pylist()) == {"train"}
    assert sorted(view.events()["sequence_id"].to_pylist()) == sorted(ids(table, "train"))


@pytest.mark.parametrize("split", ["test", "validation"])
def test_other_splits_are_refused(table, split):
    view = TrainingSplit.open(table.folder)
    for ask in (view.chunks, view.scalars):
        with pytest.raises(AdapterError, match=rf"from split 'train' only; it asked for '{split}'"):
            ask(split=split)


def test_a_method_that_reads_every_row_it_is_given_learns_from_no_test_row(table, tmp_path, install, own_cache):
    install("made", learns())
    run_method(RunRequest(method="made", condition=Condition.NONE, data=(table.folder,), out=tmp_path / "out"))
    (seen,) = own_cache.glob("fits/made-*/seen")
    assert seen.read_text().splitlines() == ids(table, "train")


def test_a_method_that_asks_for_the_test_split_is_refused(table, tmp_path, install):
    install("made", learns("split='test'"))
    with pytest.raises(AdapterError, match="it asked for 'test'"):
        run_method(RunRequest(method="made", condition=Condition.NONE, data=(table.folder,), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> SequenceTable:
    """More rows than are read at once."""
    return fake_dataset(tmp_path_factory.mktemp("large") / "table", 300)


def test_the_copy_streams_the_same_rows_in_the_same_portions(large, tmp_path):
    write_training_copy(large, tmp_path / "copy")
    whole, copy = TrainingSplit.open(large.folder), opened(tmp_path / "copy")
    portions = list(zip(whole.chunks(), copy.chunks(), strict=True))
    assert len(portions) == 2
    for expected, found in portions:
        assert expected.batch.to_pydict() == found.batch.to_pydict()
        assert np.array_equal(expected.joints.sum(axis=0), found.joints.sum(axis=0))
    assert (copy.identity, copy.content) == (whole.identity, whole.content)
    assert copy.scalars().equals(whole.scalars())


def test_no_byte_of_another_split_is_in_the_copy(table, tmp_path):
    write_training_copy(table, tmp_path / "copy")
    others = set(table.scalars(split="test")["sequence_id"].to_pylist())
    others |= set(table.scalars(split="validation")["sequence_id"].to_pylist())
    files = sorted((tmp_path / "copy").rglob("*.parquet"))
    for file in files:
        assert not others & set(pq.read_table(file).to_pydict().get("sequence_id", []))
    splits = SequenceTable(tmp_path / "copy", table.info).scalars()["split"].to_pylist()
    assert set(splits) == {"train"}
    copy = opened(tmp_path / "copy")
    assert set(copy.recordings()["split"].to_pylist()) == {"train"}
    assert copy.events().num_rows == len(splits)
    with pytest.raises(AdapterError, match="split 'train' only"):
        next(copy.chunks(split="test"))


def test_a_table_without_training_rows_makes_an_empty_copy(tmp_path):
    table = fake_dataset(tmp_path / "table", 4, recordings=4)
    keep = table.scalars(split="train").num_rows
    assert keep
    write_training_copy(_without_training(table, tmp_path), tmp_path / "copy")
    assert list(opened(tmp_path / "copy").chunks()) == []


def _without_training(table: SequenceTable, tmp_path: Path) -> SequenceTable:
    rows = pq.read_table(table.folder / "sequences.parquet")
    (tmp_path / "none").mkdir()
    for file in table.folder.iterdir():
        (tmp_path / "none" / file.name).write_bytes(file.read_bytes())
    kept = rows.filter([split != "train" for split in rows["split"].to_pylist()])
    pq.write_table(kept, tmp_path / "none/sequences.parquet")
    return SequenceTable(tmp_path / "none", table.info)


def test_a_temporary_copy_vanishes_and_those_of_killed_processes_are_cleared_away(table, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True)
    orphan, mine = tmp_path / f"prbench-train-{int(ended.stdout)}-x", tmp_path / f"prbench-train-{os.getpid()}-x"
    orphan.mkdir()
    mine.mkdir()
    copy = temporary_copy(partial(write_training_copy, table))
    assert opened(Path(copy.name)).identity == table.identity
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([mine.name, Path(copy.name).name])
    copy.cleanup()
    assert sorted(tmp_path.iterdir()) == [mine]


def test_a_copy_that_cannot_be_written_leaves_nothing(table, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def full(*_args, **_kwargs):
        raise OSError("disk full")

    monkeypatch.setattr(training_copy, "write_table", full)
    with pytest.raises(OSError, match="disk full"):
        temporary_copy(partial(write_training_copy, table))
    assert not list(tmp_path.iterdir())
