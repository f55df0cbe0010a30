"""Pickled tensors are read; anything that a pickle could run is refused and never run."""

from __future__ import annotations

import io
import os
import pickle
from collections import Counter

import numpy as np
import pytest
import torch

from prbench.errors import InputFileError
from prbench.readers.gimo.restricted_unpickling import load_tensors
from prbench.synthetic.layouts.tensor_pickles import pickled_tensors

TRACE: list[str] = []


def leave_a_trace(*_: object) -> None:
    TRACE.append("run")


class Calls:
    """Pickles as a call of ``function``."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_plainly_pickled_tensors_come_back(tmp_path, protocol) -> None:
    pose = {
        "orient": torch.tensor([0.1, -0.2, 0.3], requires_grad=True),
        "trans": torch.nn.Parameter(torch.tensor([1.0, 2.0, 3.0])),
        "latent": torch.arange(64, dtype=torch.float32)[32:],
        "beta": torch.zeros(1, 10) if protocol == 5 else np.zeros((1, 10), dtype=np.float32),
    }
    path = tmp_path / "0.pkl"
    path.write_bytes(pickle.dumps(pose, protocol=protocol))
    read = load_tensors(path)
    np.testing.assert_array_equal(read["orient"], np.float32([0.1, -0.2, 0.3]))
    np.testing.assert_array_equal(read["trans"], [1, 2, 3])
    np.testing.assert_array_equal(read["latent"], np.arange(32, 64))
    assert read["beta"].shape == (1, 10)


def test_pickles_with_a_fixed_key_are_read_by_pickle_and_by_us(tmp_path) -> None:
    values = {"orient": np.float32([1, 2, 3]), "latent": np.linspace(0, 1, 32, dtype=np.float32)}
    content = pickled_tensors(values, requires_grad=("orient",))
    path = tmp_path / "0.pkl"
    path.write_bytes(content)
    for read in (load_tensors(path), {k: v.detach().numpy() for k, v in pickle.loads(content).items()}):
        assert {name: array.tolist() for name, array in read.items()} == {n: a.tolist() for n, a in values.items()}
    assert pickle.loads(content)["orient"].requires_grad


def test_equal_numbers_give_equal_bytes() -> None:
    values = {"trans": np.float32([1, 2, 3])}
    assert pickled_tensors(values) == pickled_tensors({"trans": values["trans"].copy()})


def _in_a_storage(value: object) -> bytes:
    """A hostile pickle in the place of a tensor's storage."""
    buffer = io.BytesIO()
    torch.save(value, buffer, _use_new_zipfile_serialization=False)
    return pickle.dumps({"orient": Calls(torch.storage._load_from_bytes, buffer.getvalue())})


HOSTILE = {
    "a function of ours": lambda: pickle.dumps({"orient": Calls(leave_a_trace)}),
    "os.system": lambda: pickle.dumps(Calls(os.system, "touch hacked")),
    "eval": lambda: pickle.dumps({"orient": Calls(eval, "TRACE.append('run')")}),
    "exec by the oldest opcodes": lambda: b'c__builtin__\nexec\n(S\'open("hacked","w")\'\ntR.',
    "nested in a list": lambda: pickle.dumps({"trans": [torch.zeros(3), (Calls(leave_a_trace),)]}),
    "inside a storage": lambda: _in_a_storage(Calls(leave_a_trace)),
    "a harmless but foreign class": lambda: pickle.dumps({"orient": Counter("abc")}),
    "an attribute of an allowed module": lambda: b"cnumpy\nload\n(S'hacked'\ntR.",
    "the class of arrays, called": lambda: b"cnumpy\nndarray\n(I3\ntR.",
    "another codec": lambda: pickle.dumps({"a": Calls(__import__("_codecs").encode, "abc", "rot13")}),
    "a persistent id": lambda: b"Phacked\n.",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_pickle_is_refused_and_not_run(tmp_path, monkeypatch, name) -> None:
    monkeypatch.chdir(tmp_path)
    TRACE.clear()
    path = tmp_path / "0.pkl"
    path.write_bytes(HOSTILE[name]())
    with pytest.raises(InputFileError, match="expected a pickled dictionary of torch tensors, found the name") as error:
        load_tensors(path)
    assert "Nothing of it was run" in str(error.value)
    assert TRACE == []
    assert [found.name for found in tmp_path.iterdir()] == ["0.pkl"]


def test_the_hostile_pickles_are_hostile(tmp_path, monkeypatch) -> None:
    """What the tests above refuse would run under plain pickle."""
    monkeypatch.chdir(tmp_path)
    TRACE.clear()
    pickle.loads(HOSTILE["a function of ours"]())
    pickle.loads(HOSTILE["exec by the oldest opcodes"]())
    assert TRACE == ["run"]
    assert (tmp_path / "hacked").exists()


@pytest.mark.parametrize(
    "content", [b"", b"\x80\x04\x95\x10", b"hello", pickle.dumps([1, 2]), pickle.dumps({"a": "b"})]
)
def test_what_is_no_dictionary_of_tensors_is_refused(tmp_path, content) -> None:
    path = tmp_path / "0.pkl"
    path.write_bytes(content)
    with pytest.raises(InputFileError, match="expected a pickled dictionary of torch tensors"):
        load_tensors(path)


def test_a_huge_file_is_not_even_read(tmp_path) -> None:
    path = tmp_path / "0.pkl"
    with open(path, "wb") as file:
        file.truncate(2 << 20)
    with pytest.raises(InputFileError, match="found 2,097,152 bytes"):
        load_tensors(path)
