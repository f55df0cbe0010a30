"""The features on disk: made once, made again when the table changes, never half."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace

import pytest

from prbench.errors import TableError
from prbench_adapters.training import store
from prbench_adapters.training.dataset import SequenceDataset
from tests.adapters.training.tables import sequence_table


def stores(cache):
    return sorted(path.name for path in cache.glob("*"))


def refuse(*_, **__):
    pytest.fail("features were computed although they are there")


def test_features_are_computed_once(tmp_path, monkeypatch):
    table, cache = sequence_table(tmp_path / "t"), tmp_path / "cache"
    first = SequenceDataset(table, cache=cache)
    made = {path: path.stat().st_mtime_ns for path in cache.iterdir()}
    monkeypatch.setattr(store, "encoded", refuse)
    again = SequenceDataset(table.folder, cache=cache)
    assert again[2].features.tobytes() == first[2].features.tobytes()
    assert {path: path.stat().st_mtime_ns for path in cache.iterdir()} == made


def test_another_encoding_has_a_store_of_its_own(tmp_path):
    table, cache = sequence_table(tmp_path / "t"), tmp_path / "cache"
    ways = ({}, {"max_frames": 50}, {"mode": "reference"}, {"crop": "random"}, {"split": "test"})
    for way in ways:
        SequenceDataset(table, cache=cache, **way)
    assert len(stores(cache)) == 2 * len(ways)  # features and notes


def test_a_table_that_was_built_again_with_other_rows_gets_a_new_store(tmp_path):
    cache, folder = tmp_path / "cache", tmp_path / "t"
    before = SequenceDataset(sequence_table(folder), cache=cache)
    moved = sequence_table(folder, change=lambda row: replace(row, joints=row.joints + 0.01))
    after = SequenceDataset(moved, cache=cache)
    assert len(stores(cache)) == 4
    assert after[0].joints[0, 0, 0] == pytest.approx(before[0].joints[0, 0, 0] + 0.01, abs=1e-6)


def test_a_table_whose_file_was_changed_is_refused(tmp_path):
    cache, table = tmp_path / "cache", sequence_table(tmp_path / "t")
    SequenceDataset(table, cache=cache)
    other = sequence_table(tmp_path / "other", change=lambda row: replace(row, joints=row.joints + 0.01))
    (other.folder / "sequences.parquet").replace(table.folder / "sequences.parquet")
    with pytest.raises(TableError, match=r"not the ones that dataset\.json describes"):
        SequenceDataset(table.folder, cache=cache)


def test_a_copy_of_a_table_takes_the_store_over(tmp_path, monkeypatch):
    cache = tmp_path / "cache"
    SequenceDataset(sequence_table(tmp_path / "a"), cache=cache)
    copy = sequence_table(tmp_path / "b")
    monkeypatch.setattr(store, "encoded", refuse)
    SequenceDataset(copy, cache=cache)


def test_an_interrupted_build_leaves_nothing(tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    table, cache = sequence_table(tmp_path / "t"), tmp_path / "cache"
    with monkeypatch.context() as patch:
        patch.setattr(store, "encoded", interrupted)
        with pytest.raises(KeyboardInterrupt):
            SequenceDataset(table, cache=cache)
    assert stores(cache) == []
    assert len(SequenceDataset(table, cache=cache))


_KILLED_WHILE_WRITING = """
import os, signal, sys
from pathlib import Path
from prbench.sequences import SequenceTable
from prbench_adapters.training import store

def killed(rows, encoding):
    os.kill(os.getpid(), signal.SIGKILL)

store._encoded_rows = killed
encoding = store.DataConfiguration()
store.table_store(SequenceTable.open(Path(sys.argv[1])), "train", encoding, Path(sys.argv[2]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_what_a_killed_build_left_is_no_store_and_the_next_build_clears_it_away(tmp_path):
    table, cache = sequence_table(tmp_path / "t"), tmp_path / "cache"
    killed = subprocess.run([sys.executable, "-c", _KILLED_WHILE_WRITING, str(table.folder), str(cache)], check=False)
    assert killed.returncode == -signal.SIGKILL
    left = stores(cache)
    assert [name.startswith(".") for name in left] == [True] * 3, "a half-written store and the locks of both files"
    assert sum(name.endswith(".partial.arrow") for name in left) == 1

    assert len(SequenceDataset(table, cache=cache))
    assert [name.startswith(".") for name in stores(cache)] == [False] * 2


def test_other_code_of_the_representation_makes_its_own_store(tmp_path, monkeypatch):
    table, cache = sequence_table(tmp_path / "t"), tmp_path / "cache"
    SequenceDataset(table, cache=cache)
    monkeypatch.setattr(store, "_representation_digest", lambda: "other")
    SequenceDataset(table, cache=cache)
    assert len(stores(cache)) == 4


@pytest.mark.parametrize("suffix", [".arrow", ".json"])
def test_a_damaged_store_is_made_again(tmp_path, suffix):
    table, cache = sequence_table(tmp_path / "t"), tmp_path / "cache"
    whole = SequenceDataset(table, cache=cache)[1].features.tobytes()
    (path,) = cache.glob(f"*{suffix}")
    content = path.read_bytes()
    path.unlink()  # the dataset above still has it mapped
    path.write_bytes(content[: len(content) // 2])
    assert SequenceDataset(table, cache=cache)[1].features.tobytes() == whole
