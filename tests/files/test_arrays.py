"""What files of NumPy and Parquet declare is held against their size before memory is taken for them."""

from __future__ import annotations

import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.errors import InputFileError, PredictionsError, RunError, TableError, UnforeseenInput
from prbench.files import arrays
from prbench.files.arrays import Archive, load_array
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.scores import read_scores
from prbench.limits import LARGEST_ARRAYS
from prbench.readers.files import archive_members
from prbench.sequences.schema import open_parquet
from tests.bombs import encrypted, npy_header, npz


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (npy_header((2**40, 22, 3)), "expected at most .* declared"),  # 264 TiB
        (npy_header((10**6, 22, 3)), r"expected 264,000,000 bytes \(shape .*, found 0"),
        (npy_header((2**62, 0)), "expected an array as np.save writes it, found the shape"),
        (npy_header((10**12,), "<U0"), "expected an array as np.save writes it, found the shape"),
        (b"\x93NUMPY\x01\x00\xff\xff" + b"[" * 65_535, "expected an array as np.save writes it"),
    ],
    ids=["264 TiB", "cut off", "endless axis", "values of no size", "nested header"],
)
def test_a_header_is_not_believed(tmp_path, header, said):
    path = tmp_path / "a.npy"
    path.write_bytes(header)
    with pytest.raises(InputFileError, match=said) as caught:
        load_array(path)
    assert type(caught.value) is InputFileError


def test_arrays_are_read_as_numpy_reads_them_and_can_be_written_to(tmp_path):
    arrays = {
        "text": np.array(["ä", "bc"]),
        "empty": np.zeros((0, 3), np.float32),
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "scalar": np.array(7, np.int16),
    }
    np.savez_compressed(tmp_path / "a.npz", **arrays)
    loaded = Archive(tmp_path / "a.npz").load([*arrays, "not there"])
    assert loaded.keys() == arrays.keys()
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
        for found in (loaded[name], load_array(tmp_path / f"{name}.npy")):
            assert found.dtype == array.dtype
            np.testing.assert_array_equal(found, array)
            assert found.flags.writeable


def test_a_compressed_array_is_refused_by_what_it_declares(tmp_path):
    archive = Archive(npz(tmp_path / "bomb.npz", "joints", 80))  # 80 MB of zeros in 0.4
    assert archive.path.stat().st_size < 10**6
    for read in (lambda: archive.load(["joints"]), lambda: archive.read("joints", largest=LARGEST_ARRAYS)):
        with pytest.raises(InputFileError, match=r"bomb\.npz, 'joints': expected at most 67,108,864 bytes in"):
            read()


def test_an_encrypted_archive_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.arange(3))
    with pytest.raises(InputFileError, match=r"a\.npz: expected a readable \.npz file, found .*encrypted"):
        Archive(encrypted(tmp_path / "a.npz")).load(["a"])


def test_an_archive_that_has_lost_its_beginning_is_told_as_damaged(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(5000.0))
    (tmp_path / "a.npz").write_bytes((tmp_path / "a.npz").read_bytes()[1000:])
    with pytest.raises(InputFileError, match=r"expected a readable \.npz file") as refused:
        Archive(tmp_path / "a.npz").load(["x"])
    assert not isinstance(refused.value, UnforeseenInput)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_a_pipe_in_place_of_an_archive_is_refused_instead_of_waited_for(tmp_path):
    os.mkfifo(tmp_path / "a.npz")
    with pytest.raises(InputFileError, match=r"a\.npz: expected a file, found a pipe"):
        Archive(tmp_path / "a.npz").load(["a"])
    with pytest.raises(InputFileError, match=r"a\.npz: expected a file, found a pipe"):
        archive_members(tmp_path / "a.npz")


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
    monkeypatch.setattr("prbench.limits.MOST_VALUES", 1000)
    for name, values in {"bomb": np.zeros(10**5), "honest": np.random.default_rng(0).random(10**5)}.items():
        rows = pa.table({"joints": pa.array([values], pa.list_(pa.float64()))})
        pq.write_table(rows, tmp_path / f"{name}.parquet")
    assert arrays.read_parquet(tmp_path / "honest.parquet").num_rows == 1
    with pytest.raises(pa.ArrowInvalid, match=r"100,000 values of 'joints\.list\.element' declared in row group 0"):
        arrays.read_parquet(tmp_path / "bomb.parquet")


def test_a_column_that_is_there_twice_is_named(tmp_path):
    pq.write_table(pa.table([[1], [2], [3]], names=["a", "b", "b"]), tmp_path / "a.parquet")
    with pytest.raises(pa.ArrowInvalid, match="the column 'b' is there twice"):
        arrays.read_parquet(tmp_path / "a.parquet", ["a"])


def test_a_column_that_is_not_there_is_named(tmp_path):
    pq.write_table(pa.table({"a": [1]}), tmp_path / "a.parquet")
    with pytest.raises(pa.ArrowInvalid, match="no column 'b'"):
        arrays.read_parquet(tmp_path / "a.parquet", ["a", "b"])
