"""Whole and cut files of every kind; each is made here, so that its cut copy differs in nothing else."""

from __future__ import annotations

import json
import pickle
import zipfile

import h5py
import numpy as np
import pytest

from prbench.readers.extents import damage
from prbench.readers.found import InputFile, input_file


def write_csv(path) -> None:
    path.write_text("time,x,y\n1,2,3\n2,3,4\n")


def write_json(path) -> None:
    path.write_text(json.dumps({"a": [1, 2, {"b": 3}]}))


def write_json_lines(path) -> None:
    path.write_text('{"a": 1}\n{"a": 2222}\n')


def write_hdf5(path) -> None:
    with h5py.File(path, "w") as file:
        file["data"] = np.arange(20000.0)


def write_npz(path) -> None:
    np.savez(path, a=np.arange(50.0))


def write_pickle(path) -> None:
    path.write_bytes(pickle.dumps({"a": list(range(100))}))


KINDS = {
    "t.csv": write_csv, "t.json": write_json, "t.jsonl": write_json_lines, "t.hdf5": write_hdf5, "t.npz": write_npz,
    "t.pkl": write_pickle,
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_a_whole_file_passes_and_a_cut_one_does_not(tmp_path, name) -> None:
    path = tmp_path / name
    KINDS[name](path)
    assert damage(input_file("any", path)) == ""
    content = path.read_bytes()
    path.write_bytes(content[: -max(4, len(content) // 5)])
    assert damage(input_file("any", path)) != ""
    path.write_bytes(b"")
    assert damage(input_file("any", path)) == "empty"


def test_an_archive_must_hold_the_file_that_is_wanted(tmp_path) -> None:
    path = tmp_path / "slam.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("0/slam/closed_loop_trajectory.csv", "a,b\n1,2\n")
    assert damage(InputFile("trajectory", path, 8, member="0/slam/closed_loop_trajectory.csv")) == ""
    assert "holds no" in damage(InputFile("trajectory", path, 8, member="1/slam/closed_loop_trajectory.csv"))


def test_a_file_that_went_away_is_told_and_does_not_end_the_inspection(tmp_path) -> None:
    assert "cannot be read" in damage(InputFile("gaze", tmp_path / "gone.csv", 8))
