"""Whatever goes wrong while a foreign file is read becomes one message that names the file."""

from __future__ import annotations

import inspect
import pickle
from pathlib import Path

import msgspec
import pytest

from prbench.datasets import readable_datasets
from prbench.errors import InputFileError, TableError, UnforeseenInput
from prbench.files.bounded import foreign_input
from prbench.readers import files, reader_for
from prbench.readers.files import decode_json


def test_an_unforeseen_error_names_the_file_its_kind_and_its_cause(tmp_path, monkeypatch):
    def stumble(_: Path, **_limits: int) -> bytes:
        raise TypeError("no number")

    monkeypatch.setattr(files, "read_all", stumble)
    with pytest.raises(UnforeseenInput, match=r"numbers\.json: .*TypeError: no number") as caught:
        decode_json(tmp_path / "numbers.json", msgspec.json.Decoder())
    assert caught.value.path == tmp_path / "numbers.json"
    assert isinstance(caught.value.__cause__, TypeError)


def test_an_unforeseen_error_is_the_same_in_another_process():
    error = UnforeseenInput("a.csv", "line 2", expected="a number", found="KeyError: 'x'", remedy="Copy it again.")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is UnforeseenInput
    assert (str(copy), copy.path, copy.where) == (str(error), error.path, error.where)


@pytest.mark.parametrize("make", [Path.mkdir, lambda path: path.symlink_to(path)], ids=["folder", "looping link"])
def test_what_is_no_file_is_refused_with_what_the_system_says(tmp_path, make):
    path = tmp_path / "metadata.json"
    make(path)
    with pytest.raises(InputFileError, match=r"metadata\.json: expected a file.*, found") as caught:
        decode_json(path, msgspec.json.Decoder())
    assert type(caught.value) is InputFileError


def test_json_nested_too_deep_is_refused(tmp_path):
    path = tmp_path / "deep.json"
    path.write_bytes(b"[" * 100_000 + b"]" * 100_000)
    with pytest.raises(InputFileError, match=r"deep\.json: expected values nested at most") as caught:
        decode_json(path, msgspec.json.Decoder())
    assert type(caught.value) is InputFileError


def test_bytes_that_are_no_text_are_refused_and_not_unforeseen():
    said = "input: expected text in UTF-8, found other bytes"
    with pytest.raises(InputFileError, match=said) as caught, foreign_input():
        b"\xff".decode()
    assert type(caught.value) is InputFileError


@pytest.mark.parametrize("error", [TableError("a message"), MemoryError()], ids=["a user's error", "no memory"])
def test_errors_that_are_told_already_and_a_lack_of_memory_pass(error):
    with pytest.raises(type(error)) as caught, foreign_input():
        raise error
    assert caught.value is error


def test_where_no_path_is_known_the_place_given_is_named():
    with pytest.raises(UnforeseenInput, match="a stream: "), foreign_input("a stream"):
        raise KeyError("x")


@pytest.mark.parametrize("dataset", readable_datasets())
def test_every_reader_stands_behind_the_boundary(dataset):
    reader = reader_for(dataset)
    for door in (reader.find, reader.read):
        assert inspect.unwrap(door) is not door, f"put @foreign_input() over {door.__qualname__}"
